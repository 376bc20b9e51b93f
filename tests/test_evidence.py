"""Stored evidence: displayed correctly, consistent with the documentation, and reproducible."""

import math

import numpy as np
import pytest
from scipy.stats import binomtest, chisquare

from evidence import FOLDER, PAGE, STUDIES, page, read
from evidence._coverage import p_value

SHARE = 0.02
# A study without a run has no figures yet, and no section on the page.
STORED = {name: study for name, study in STUDIES.items() if (FOLDER / f"{name}.json").exists()}


def figures_of(name):
    if name not in STORED:
        pytest.skip(f"the study '{name}' was never run")
    content = read(STUDIES[name])
    return content["size"], content["figures"]


@pytest.mark.quick
@pytest.mark.parametrize("study", STORED.values(), ids=list(STORED))
def test_the_stored_run_can_be_had_again(study):
    """It has the size and seed of the study, and a commit that contains the code that was run."""
    content = read(study)
    assert (content["study"], content["size"], content["seed"]) == (
        study.name, study.size, study.seed,
    )  # fmt: skip
    assert len(content["commit"]) == 40
    assert not content["uncommitted_changes"]
    assert {"python", "giajax", "jax"} <= set(content["versions"])


@pytest.mark.quick
def test_the_page_shows_what_is_stored():
    assert PAGE.read_text(encoding="utf-8") == page(STUDIES.values())


@pytest.mark.quick
def test_95_percent_intervals_hold_the_truth_as_often_as_they_say():
    """With white and correlated noise; and no estimate is biased."""
    size, figures = figures_of("coverage")
    assert len(figures) == 12
    for case, each in figures.items():
        assert each["fits"] == size
        assert each["converged"] > 0.99 * size, case
        assert p_value(each) > 0.01 / len(figures), case
        for path, one in each["parameters"].items():
            spread = one["deviation_of_pulls"] / math.sqrt(size)
            assert abs(one["mean_pull"]) < 4 * spread, f"{case}, {path}"


@pytest.mark.quick
def test_an_adequate_model_is_seldom_called_inadequate():
    """At most 10 in 200, with white noise or with the stated correlation."""
    _, figures = figures_of("coverage")
    adequate = {case: each for case, each in figures.items() if each["adequate"]}
    assert len(adequate) == 5
    for case, each in adequate.items():
        assert each["inadequate"] <= 10 / 200 * each["fits"], case
    silent = [each for each in figures.values() if not each["adequate"]]
    assert all(each["inadequate"] >= 0.95 * each["fits"] for each in silent)


@pytest.mark.quick
def test_intervals_hold_the_truth_whatever_the_memory_of_the_noise():
    """93 to 97 % of the 95 % intervals contain the true value."""
    _, figures = figures_of("noise")
    assert len(figures) == 40
    for case, each in figures.items():
        assert abs(each["within"] / each["intervals"] - 0.95) < 0.02, case
        if each["correlation_times"] is not None and each["correlation_times"] < 20:
            assert each["seen_as_short"] > 0.9 * each["records"], case
    # Alternative methods, for a correlation of ten samples.
    other = figures["rho 0.9, 250 samples, even, 1 channel, not stated"]
    assert other["within_if_white"] < other["within_hac"] < other["within_glsar"]
    assert other["within_glsar"] < other["within"]


@pytest.mark.quick
def test_an_omission_is_seen_and_found():
    size, figures = figures_of("suspects")
    assert sum(each["inadequate"] for each in figures.values()) >= 0.95 * size * len(figures)
    # For a random walk, there is no correct interval.
    known = [each for name, each in figures.items() if name != "a random walk"]
    assert len(known) == 8
    assert sum(each["found"] for each in known) >= 0.8 * size * len(known)


@pytest.mark.quick
def test_the_ladder_leads_to_what_acts_on_a_link_for_its_mass():
    """Within 3 standard errors, from a third of it; with free masses, combinations are found."""
    _, figures = figures_of("ladder")
    drag, stiffness = "air.drag_coefficient", "joints.pitch_stiffness"
    for path in (drag, stiffness, "joints.damping"):
        assert is_within(figures["for_their_mass"][path]), path
        assert is_within(figures["with_the_mass"][path]), path
    first = figures["rungs"][0]["parameters"][drag]
    assert abs(first["value"] - 1.2) > 100 * first["error"]
    # If the masses are free, too, neither has an error.
    assert "only_combinations" in figures["scale"]["findings"]
    assert {"links.mass[0]", drag, stiffness} <= set(figures["scale"]["without_error"])


@pytest.mark.quick
def test_the_ladder_leads_from_the_papers_model_to_that_of_another_engine():
    """The added effects of the air are found within 3 standard errors; the first fit is far off."""
    _, figures = figures_of("ladder_friction")
    assert len(figures["found"]) == 5
    for path, one in figures["found"].items():
        assert is_within(one), path
    assert figures["air"] == {"drag": "strip", "added_mass": "inertia", "has_added_mass": True}
    first, last = figures["rungs"][0], figures["rungs"][-1]
    assert first["chi_square"] > 9 * last["chi_square"]
    assert last["chi_square"] < 1.1 * last["values"]


@pytest.mark.quick
def test_an_explanation_is_as_good_as_a_model_built_by_hand():
    """Ten recordings with five omissions: right, adequate and hardly wider in at least eight."""
    size, figures = figures_of("explained")
    assert len(figures) == size
    good = [
        abs(each["explained"]["off"]) < 3
        and not each["sentences"]
        and each["explained"]["error"] < 2 * each["by hand"]["error"]
        for each in figures.values()
    ]
    assert sum(good) >= 0.8 * size


@pytest.mark.quick
def test_profiles_agree_with_errors_where_these_are_right_and_hold_the_truth_where_not():
    """Within 10 % for a well-determined fit; also at a bound and in a curved valley."""
    _, figures = figures_of("profile")
    for path, (low, high) in figures.pop("base_step").items():
        assert max(abs(low), abs(high)) < 0.1, path
    for case, each in figures.items():
        for path, one in each.items():
            chance = binomtest(one["by_profile"], one["fits"], 0.95, "less").pvalue
            assert chance > 0.01, f"{case}, {path}"
    # The part beyond the bound is excluded, and in the valley the standard error is too small.
    assert figures["a bound"]["slope"]["width"] < 0.8
    assert figures["a bent valley"]["amplitude"]["width"] > 1.1


@pytest.mark.quick
def test_a_posterior_is_the_linear_interval_where_that_is_right_and_holds_the_truth_elsewhere():
    size, figures = figures_of("posterior")
    for each in figures["agreement"].values():
        assert each["divergences"] == 0
        for path, one in each["parameters"].items():
            assert abs(one["width"] - 1) < 0.1, path
            assert abs(one["shift"]) < 0.05, path
            assert min(one["ess_bulk"], one["ess_tail"]) >= 4000, path
            assert one["r_hat"] < 1.01, path
    for name, case in figures["calibration"].items():
        assert case["repetitions"] == size
        for path, one in case["parameters"].items():
            assert chisquare(one["ranks"]).pvalue > 0.01, f"{name}, {path}"
            assert binomtest(one["posterior"], size, 0.95).pvalue > 0.01, f"{name}, {path}"


@pytest.mark.quick
def test_shaped_commands_leave_little_swing():
    """2 % of the travel, and 5 % for robust shapers if the stiffness is 25 % off."""
    size, figures = figures_of("shaping")
    assert figures["links"] == 20
    assert set(figures["durations"]) == {"0.5", "1", "1.5"}
    for duration, rows in figures["durations"].items():
        for name in ("ZV", "ZVD", "EI"):
            right, off = (np.asarray(rows[name][what]) for what in ("right", "stiffness_off"))
            assert len(right) == len(off) == size
            assert np.count_nonzero(right <= 2.0) >= size - 1, (duration, name)
            assert np.max(right) < 2.1, (duration, name)
            assert name == "ZV" or np.max(off) <= 5.0, (duration, name)
            assert np.all(right < 0.3 * np.asarray(rows["unshaped"]["right"])), (duration, name)


@pytest.mark.quick
def test_a_tracked_arm_is_where_it_is_said_to_be():
    """Tip within 0.10 m and cross-wind within 0.05 m/s, with consistent standard deviations."""
    size, figures = figures_of("tracking")
    arms = figures["arms"]
    assert figures["links"] == 20
    assert len(arms) == size
    for arm in arms:
        assert max(arm["tip_m"], arm["tip_smoothed_m"], arm["tip_in_time_m"]) < 0.10
        assert arm["wind_across_m_per_s"] < 0.05
        # The intervals of an arm with hysteresis are too wide.
        assert (0.7 if not arm["memory"] else 0.4) < arm["nees"] < 1.3
        assert 0.90 < arm["covered"] < (0.98 if not arm["memory"] else 1.0)
        assert arm["right"]
        assert arm.get("gusts_called", True)


@pytest.mark.quick
def test_a_leak_is_seen_soon_and_none_where_there_is_none():
    size, figures = figures_of("leaks")
    arms = figures["arms"]
    assert figures["links"] == 20
    assert len(arms) == size
    soon = [arm["found_after_s"] is not None and arm["found_after_s"] <= 30 for arm in arms]
    assert np.mean(soon) >= 0.9
    assert sum(arm["false_alarms"] + arm["false_before_leak"] for arm in arms) == 0
    off = np.array([arm["drag_off_in_errors"] for arm in arms])
    assert np.count_nonzero(np.abs(off) < 2) >= 0.9 * size
    # The tracker allows for an unmodelled torque, unlike a fit.
    assert all(arm["drag_error_over_fit"] < 1.7 for arm in arms)
    # A tracker with the same assumptions as the fit gives the same estimate.
    assert all(abs(arm["alike_from_fit_in_errors"]) < 0.1 for arm in arms)
    assert all(arm["alike_error_over_fit"] == pytest.approx(1, abs=0.02) for arm in arms)


def is_within(one):
    return abs(one["value"] - one["truth"]) < 3 * one["error"]


# notebooks/04_trust.ipynb also checks that suspects find omitted effects, in less time.
AGAIN = {name: study for name, study in STORED.items() if name != "suspects"}


@pytest.mark.long
@pytest.mark.parametrize("study", AGAIN.values(), ids=list(AGAIN))
def test_a_part_of_a_study_run_again_agrees_with_what_is_stored(study):
    stored = read(study)
    size = math.ceil(SHARE * stored["size"])
    again = (study.part or study.run)(size, stored["seed"] + 1)
    assert study.disagreements(stored["figures"], again) == []


@pytest.mark.quick
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"within": 4}, "4 of 10 intervals contain the truth; stored: 470 of 500"),
        ({"mean_pull": 2.0}, "the mean pull is 2.00; stored: 0.02"),
        ({"deviation_of_pulls": 2.5}, "the standard deviation of the pulls is 2.50; stored: 1.01"),
        ({"truth": 3.0}, "the truth is 3.0; stored: 2.0"),
        ({}, None),
    ],
)
def test_what_disagrees_is_said(change, sentence):
    """Standard errors that are too small by a factor of 2.5 are detected with ten fits."""

    def figures(fits, **one):
        counts = {"fits": fits, "converged": fits, "inadequate": 0}
        return {"case": {**counts, "parameters": {"k": one}}}

    stored = figures(
        500, truth=2.0, intervals=500, within=470, mean_pull=0.02, deviation_of_pulls=1.01
    )
    one = {"truth": 2.0, "intervals": 10, "within": 10, "mean_pull": -0.2}
    new = figures(10, **{**one, "deviation_of_pulls": 0.9, **change})
    sentences = STUDIES["coverage"].disagreements(stored, new)
    assert sentences == ([] if sentence is None else [f"case, k: {sentence}"])


@pytest.mark.quick
def test_a_fit_spreads_as_far_as_its_standard_errors_say():
    """Within 10 %, which is 2.8 Monte Carlo errors for 400 repetitions."""
    size, figures = figures_of("bootstrap")
    assert figures["repetitions"] == size
    assert figures["came_back"] >= 0.99 * size
    assert "air.drag_coefficient" in figures["parameters"]
    for path, one in figures["parameters"].items():
        assert abs(one["spread"] - 1) < 0.1, path
        assert abs(one["bias"]) < 0.2, path
        assert 0.92 < one["coverage"] < 0.98, path


@pytest.mark.quick
def test_a_step_tells_what_a_part_of_the_data_does():
    """Compared with a fit without the part, the shifts of all parameters have the same order."""
    _, figures = figures_of("influence")
    assert len(figures) == 3
    for case, one in figures.items():
        assert one["converged"] == one["parts"], case
        assert one["rank_correlation"] > 0.95, case


@pytest.mark.quick
def test_whoever_is_killed_no_fit_of_a_sweep_is_lost_or_done_twice():
    size, figures = figures_of("sweep")
    for by in ("two processes", "a cluster of two"):
        one = figures[by]
        assert one["rows"] == one["fits"] == size, by
        assert (one["kills"], one["workers_killed"]) == (3, 1), by
        assert (one["lost"], one["done_twice"], one["failed"]) == (0, 0, 0), by
        assert one["identical_to_serial"], by


@pytest.mark.quick
def test_two_workers_are_faster_than_one():
    _, figures = figures_of("sweep_speed")
    assert figures["times_faster"] >= 1.7


@pytest.mark.quick
def test_a_design_halves_the_error_also_of_an_arm_that_it_did_not_know():
    """In expectation and in fits, whose scatter is as expected if no effect is omitted."""
    size, figures = figures_of("design")
    assert figures["ratio"] <= 0.5
    step, designed = (figures["experiments"][name] for name in ("base step", "design"))
    for each in (step, designed):
        foreseen, unknown = each["as_foreseen"], each["unknown"]
        assert foreseen["fits"] == size
        assert foreseen["converged"] >= 0.95 * size
        # Three Monte Carlo errors of a standard deviation, and of a mean.
        assert abs(foreseen["spread"] / each["expected"] - 1) < 3 / math.sqrt(2 * size)
        for one in (foreseen, unknown):
            assert abs(one["mean"] - 1.12) < 3 * one["spread"] / math.sqrt(one["fits"])
        assert unknown["fits"] == size // 2
        # The remaining effect of the gusts is not white noise.
        assert unknown["spread"] < 1.5 * unknown["stated"]
        wind, memory = each["suggested"]
        assert wind[0].startswith("air.wind")
        assert "joints.memory.strength = 0.02 N m" in memory
    for world in ("as_foreseen", "unknown"):
        assert designed[world]["spread"] <= 0.5 * step[world]["spread"]


@pytest.mark.quick
def test_a_certificate_is_calibrated_and_better_than_knowing_the_air():
    """Over 1,000 missions; each is predicted without using itself."""
    size, figures = figures_of("certificate")
    assert figures["cases"] == size >= 1000
    assert figures["spiegelhalter_p"] > 0.05
    assert figures["hosmer_lemeshow_p"] > 0.05
    assert 0.2 < figures["inside"] / size < 0.9
    assert figures["skill"] > 0.2
    assert figures["skill"] > figures["skill_of_the_true_air"]
    middling = figures["middling"]
    assert middling["cases"] > size / 2
    # The criterion there is 0.2, but the skill reaches only this.
    assert middling["skill"] > 0.1
    assert middling["skill"] > 2 * max(middling["skill_of_the_true_air"], 0)
    assert figures["air_holds"] > 0.9 * size
    # Hotelling's test has a level of 0.1 %, so more than 6 of 1,000 similar rests are unlikely.
    assert figures["unlike"] <= 6


@pytest.mark.quick
def test_the_tip_is_held_in_moving_air():
    """Within a fifth of the swing of an uncontrolled arm; better than tuned alternatives."""
    size, figures = figures_of("holding")
    swings = {
        name: [np.inf if x is None else x for x in each]
        for name, each in figures["swing_m"].items()
    }
    assert {len(each) for each in swings.values()} == {size}
    middle = {name: np.median(each) for name, each in swings.items()}
    assert middle["mpc"] <= 0.2 * middle["nobody"]
    assert max(swings["mpc"]) <= 0.2 * max(swings["nobody"])
    assert middle["mpc"] <= 1.5 * middle["mpc that knows all"]
    for other in ("PD", "LQG of the arm without its air"):
        assert middle["mpc"] < middle[other]
        assert max(swings["mpc"]) < max(swings[other])
    # The margins of the nominal arm.
    for margin in ("0.2 s late", "1 s late", "joints turn by 0.85", "joints turn by 1.2"):
        assert middle[f"mpc, {margin}"] <= 0.2 * middle["nobody"]
    assert figures["step_ms"]["p99"] <= 250


@pytest.mark.quick
def test_the_tip_is_steered_in_sooner_more_often_and_with_fewer_touches():
    """Compared with the retuned operator, in the same arms and air."""
    size, figures = figures_of("steering")
    for kind, least in (("on the level", (70, 70)), ("along the line", (70, 68))):
        rows = {(row["driver"], row["wind_m_per_s"]): row for row in figures[kind]}
        for wind, inside in zip((0.2, 0.3), least, strict=True):
            mpc, operator = rows["mpc", wind], rows["operator, retuned", wind]
            assert mpc["cases"] == operator["cases"] == size == 72
            assert mpc["inside"] >= max(inside, operator["inside"])
            assert mpc["median_s"] <= 110 < operator["median_s"]
            assert mpc["touched"] <= operator["touched"] / 2
        alike, known = (
            rows[f"mpc{name}, 200 s", 0.2]["median_s"]
            for name in (", some of these", " that knows all")
        )
        assert alike <= 1.3 * known
    assert sum(figures[kind][2]["inside"] for kind in figures) >= 142


@pytest.mark.quick
def test_the_operator_reaches_the_opening():
    """For both readings of the 14 m: in at least 90 % at 0.2 m/s, without flattened links."""
    size, figures = figures_of("missions")
    rows = [row for each in figures.values() for row in each["winds"]]
    assert sum(row["cases"] for row in rows) >= size
    for each in figures.values():
        assert [row["wind_m_per_s"] for row in each["winds"]][-1] == 0.3
        share = {row["wind_m_per_s"]: row["inside"] / row["cases"] for row in each["winds"]}
        assert share[0.2] >= 0.9
        medians = [row["quartiles_s"][1] for row in each["winds"]]
        assert medians[-1] > medians[0]
    for row in rows:
        assert row["largest_flattening_m"] < 0.15
        assert row["inside"] + sum(row["reasons"].values()) == row["cases"]
