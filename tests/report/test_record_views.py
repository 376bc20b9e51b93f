"""Records of studies: each type names its file, can be read back, and is shown by its view."""

import dataclasses

import pytest

from giajax import InputError
from giajax.report import PageSection, RecordView, Table, view_of
from giajax.studies import Bootstrap, Influence, PosteriorSummary, Profiles, StudyRecord

pytestmark = pytest.mark.quick


@dataclasses.dataclass(frozen=True)
class Weighed(StudyRecord, file="weighed.json", head={"version": 2}, remedy="weigh it again"):
    """A record of an application."""

    masses: tuple[float, ...]


def test_an_application_makes_the_view_of_its_record():
    found = Weighed((0.5, 1.5))
    with pytest.raises(KeyError):
        view_of(found)
    table = Table(["kg"], [["0.5"], ["1.5"]])
    view = RecordView(
        record=Weighed,
        table=lambda found, result, most: table,
        sentences=lambda found, most: [],
        section=lambda found, result, folder: PageSection(
            id="w", name="W", heading="W", table=table
        ),
    )
    assert view_of(found) is view


def test_a_record_is_read_again_or_refused_in_a_sentence():
    found = Weighed((0.5, 1.5))
    assert Weighed.of_json(found.to_json()) == found
    for text in ("[]", '{"version": 1, "masses": []}', '{"version": 2, "mass": []}'):
        with pytest.raises(
            InputError, match=r"not a valid weighed\.json file of this version.*: weigh it again"
        ):
            Weighed.of_json(text)


def test_each_record_of_a_study_has_its_own_file():
    files = [kind.file for kind in (Bootstrap, Influence, PosteriorSummary, Profiles)]
    assert len(set(files)) == len(files)
