"""Reports in a browser, wide and narrow: no console messages, and every plot is drawn."""

import json
import re
from pathlib import Path

import pytest

from docs.machinery import browse
from giajax.cli import main
from giajax.fitting import load_result
from giajax.report import report_page
from page_reader import Page

FITS = Path(__file__).parents[2] / "fits"
EARLIER = Path(__file__).parents[1] / "earlier" / "written" / "beside"
# All studies of a fit, with fewer draws than by default.
STUDIES = {
    "suspects": [],
    "profile": [],
    "bootstrap": ["--size", "40"],
    "influence": [],
    "posterior": ["--chains", "2", "--draws", "60", "--warmup", "60"],
}


@pytest.mark.slow
def test_a_page_is_drawn_and_what_is_not_is_told(result, run, browser, tmp_path):
    page = report_page(result, [run])
    place = next(a["data-plot"] for _, a in Page(page).tags if "data-plot" in a)
    data = re.compile(rf'(id="{place}"[^>]*>).*?(</script>)'.encode(), re.DOTALL)
    (tmp_path / "whole.html").write_bytes(page)
    (tmp_path / "broken.html").write_bytes(data.sub(rb"\1{}\2", page, count=1))
    told = browse.opened(tmp_path, browser)
    assert [line for line in told if "whole.html" in line] == []
    assert [line for line in told if "does not draw" in line] == [
        f"/broken.html does not draw {place} at {width} px" for width in browse.WIDTHS
    ]


def test_a_page_with_every_study_of_an_earlier_fit(browser, tmp_path):
    page = tmp_path / "report.html"
    assert main(["report", str(EARLIER / "fit"), "--page", str(page), "--quiet"]) == 0
    studies = {"profiles", "suspects", "repetitions", "influence", "posterior"}
    assert studies <= set(Page(page.read_bytes()).headings)
    assert browse.opened(tmp_path, browser) == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["base_step", "joint", "muscle_empirical"])
def test_a_shipped_fit_with_every_study(name, browser, tmp_path):
    folder = tmp_path / name

    def giajax(*words):
        assert main([str(word) for word in words]) == 0

    giajax("fit", FITS / f"{name}.toml", "--starts", "3", "--out", folder, "--quiet")
    for study, options in STUDIES.items():
        giajax(study, folder, "--quiet", *options)
    (tmp_path / "site").mkdir()
    giajax("report", folder, "--page", tmp_path / "site" / "report.html")
    assert browse.opened(tmp_path / "site", browser) == []
    page = Page((tmp_path / "site" / "report.html").read_bytes())
    assert {"profiles", "repetitions", "influence", "posterior"} <= set(page.headings)
    assert "Optima reached from the starting points" in page.text
    shown = load_result(folder).shown
    exact = [json.loads(a["data-exact"]) for _, a in page.tags if "data-exact" in a]
    assert exact == [estimate.value for estimate in shown.values()]
