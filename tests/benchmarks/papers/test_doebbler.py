"""Doebbler's Table II: the simulation against the tasks' scores, its conditions, and what people are shown."""

import dataclasses
import json

import numpy as np
import pytest

from benchmarks.papers import select_tables
from benchmarks.papers.assumptions import Assumptions
from benchmarks.papers.comparison import Effort
from benchmarks.papers.doebbler import COLUMNS, TABLE_2
from benchmarks.papers.simulations import Conditions, errors_of_sets, mean_errors, rolled_square
from benchmarks.scoring.registry import score
from benchmarks.tasks.kinematic import CALIBRATED, UNCALIBRATED, KinematicUMBmark, ParameterErrors
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import preset
from estimators.robots.cast import CAST
from estimators.robots.ipec import IPEC

FEW = 40
ESTIMATORS = {"IPEC-1": lambda: IPEC(1), "CAST-1": lambda: CAST(1), "CAST-0": lambda: CAST(0)}


@pytest.fixture(scope="module")
def table():
    (source,) = select_tables(["doebbler-2"])
    return source.compute(Effort(FEW))


@pytest.fixture(scope="module")
def values(table):
    """Return the computed values, mm, by (simulation, robot file, estimator)."""
    return {tuple(value for _, value in comparison.place): comparison.ours for comparison in table.comparisons}


def followed(estimator, robot, log):
    """Return the poses (N, 3) of one estimator on one run, sample by sample."""
    estimator.reset(robot, log.reference[0])
    wheel = np.diff(log.wheel, axis=0, prepend=log.wheel[:1])
    return np.array(
        [
            estimator.update({"wheel": wheel[k], "pivot": log.pivot[k], "time": log.t[k : k + 1]})
            for k in range(len(log.t))
        ]
    )


@pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")
@pytest.mark.parametrize(
    ("errors", "corners", "case"),
    [
        (UNCALIBRATED, "turn", 1),
        (CALIBRATED, "fixed", 0),
    ],
    ids=["uncalibrated-turn", "calibrated-fixed"],
)
def test_every_set_is_the_tasks_case_followed_run_by_run(errors, corners, case):
    found = errors_of_sets(Conditions(Assumptions(corners=corners), sets=2), errors)
    task = KinematicUMBmark("square", "", "", errors, corners)
    episode = task.record(case)
    for name, estimator in ESTIMATORS.items():
        paths = [followed(estimator(), episode.robot, run.log)[run.samples] for run in episode.runs]
        assert found[name][case] == pytest.approx(score(episode, paths)["E_max_syst"], abs=1e-9)


def test_sets_computed_together_or_in_turn_are_equal():
    conditions = Conditions(Assumptions(runs=2), sets=3)
    together = errors_of_sets(conditions, CALIBRATED)
    for name, found in errors_of_sets(conditions, CALIBRATED, at_a_time=4).items():
        np.testing.assert_allclose(found, together[name], rtol=0, atol=1e-12)


def test_mean_and_standard_error_are_those_of_the_sets():
    conditions = Conditions(Assumptions(runs=1), sets=6)
    means = mean_errors(conditions, UNCALIBRATED)
    for name, found in errors_of_sets(conditions, UNCALIBRATED).items():
        mean = sum(found) / 6
        assert means[name].mean == pytest.approx(mean)
        assert means[name].standard_error == pytest.approx((sum((found - mean) ** 2) / 5 / 6) ** 0.5)


def test_without_errors_and_with_fine_encoders_only_euler_steps_err(tmp_path):
    """Between samples castors do not turn quite evenly: 0.2 mm stays (IPEC: 1.6 mm), of 1.5 m squares."""
    robot = preset("asoc-prototype")
    fine = dataclasses.replace(
        robot,
        castors=tuple(
            dataclasses.replace(
                castor,
                pivot_counts_per_rev=10**8,
                wheels=tuple(dataclasses.replace(wheel, counts_per_rev=10**8) for wheel in castor.wheels),
            )
            for castor in robot.castors
        ),
    )
    fine.save(tmp_path / "fine.json")
    assumed = Assumptions(robot=str(tmp_path / "fine.json"))
    no_errors = ParameterErrors(0.0, 0.0, 0.0, 0.0)
    for encoders in ("honest", "lossy"):
        found = errors_of_sets(Conditions(assumed, sets=2, encoders=encoders), no_errors)
        assert np.max(found["IPEC-1"]) < 2e-3
        assert max(np.max(found["CAST-1"]), np.max(found["CAST-0"])) < 3e-4
    floor = errors_of_sets(Conditions(assumed, sets=2, step="euler"), no_errors)
    assert min(np.min(error) for error in floor.values()) > 0.05


def test_the_third_castor_helps_and_two_castor_methods_agree(values):
    for file in TABLE_2:
        ipec, cast, all_castors = (values["honest-arc", file, name] for name in ESTIMATORS)
        assert all_castors < 0.9 * cast
        assert ipec == pytest.approx(cast, rel=0.08)


def test_uncalibrated_errors_are_the_papers_and_calibrated_ones_far_below(table):
    for comparison in table.comparisons:
        place = dict(comparison.place)
        if place["simulation"] == "honest-arc":
            if place["robot_file"] == "uncalibrated":
                assert abs(comparison.ours - comparison.printed) < 3 * comparison.standard_error
            else:
                assert comparison.ratio < 0.2


def test_lossy_encoders_and_euler_steps_are_ten_times_worse_after_calibration(values):
    for name in ESTIMATORS:
        ratio = values["lossy-euler", "calibrated", name] / values["honest-arc", "calibrated", name]
        assert 7 < ratio < 20


def test_the_swing_of_the_pivots_decides_about_the_third_castor(values):
    """Euler's step turns the swing by the end heading too, or not: two castors hardly notice, three do."""
    for name in ("IPEC-1", "CAST-1"):
        swung, exact = (values[step, "calibrated", name] for step in ("lossy-euler", "lossy-euler-axle"))
        assert exact == pytest.approx(swung, rel=0.1)
    assert values["lossy-euler", "calibrated", "CAST-0"] == pytest.approx(97.2, abs=2.0)
    assert values["lossy-euler-axle", "calibrated", "CAST-0"] == pytest.approx(15.2, abs=2.0)


def test_phases_do_not_matter_to_lossy_encoders():
    single, several = (
        errors_of_sets(Conditions(Assumptions(runs=runs), sets=2, encoders="lossy"), CALIBRATED) for runs in (1, 3)
    )
    for name in ESTIMATORS:
        np.testing.assert_allclose(single[name], several[name], rtol=1e-12)


@pytest.mark.parametrize("times", [1, 2])
def test_normal_errors_have_the_same_mean_size(times):
    random, robot = np.random.default_rng(5), preset("asoc-prototype")
    errors = dataclasses.replace(UNCALIBRATED, radius=times * UNCALIBRATED.radius)
    files = [errors.applied(robot, random, "normal") for _ in range(500)]
    off = np.array([wheel.radius / 0.0381 - 1 for file in files for wheel in file.wheels]) / times
    assert np.mean(abs(off)) == pytest.approx(0.0207, rel=0.05)
    assert np.max(abs(off)) > 2.5 * 0.0207  # a uniform error is never above twice its mean size


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"encoders": "perfect"}, "unknown encoders 'perfect'; known: honest, lossy"),
        ({"sets": 0}, "sets must be at least 1, got 0"),
    ],
)
def test_unknown_conditions_are_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        Conditions(**wrong)


@pytest.mark.parametrize("direction", ["cw", "ccw"])
@pytest.mark.parametrize("radius", [0.159, 0.3])
def test_rounded_squares_close_and_are_as_long_as_sides_and_quarter_circles(direction, radius):
    assumed = Assumptions(corners="rounded", corner_radius=radius)
    square = assumed.square(direction)
    assert square.path_length == pytest.approx(4 * (1.5 - 2 * radius) + 2 * np.pi * radius, abs=1e-12)
    pose, _ = square.at(np.linspace(0.0, square.duration, 1000))
    turn = 2 * np.pi if direction == "ccw" else -2 * np.pi
    np.testing.assert_allclose(pose[-1], [0, 0, turn], atol=1e-9)
    x, y = pose[:, :2].T
    assert (np.ptp(x), np.ptp(y)) == pytest.approx((1.5, 1.5), abs=1e-3)


def test_default_rounded_corners_give_the_path_that_the_printed_percentages_imply():
    assert Assumptions(corners="rounded").square("ccw").path_length == pytest.approx(5.727, abs=1e-3)


@pytest.mark.parametrize(("corners", "length"), [("turn", 6.0), ("fixed", 6.0), ("rounded", 5.727)])
def test_percentages_are_of_the_path_they_name(corners, length):
    (source,) = select_tables(["doebbler-2"])
    table = source.compute(Effort(2, assumptions=Assumptions(corners=corners, runs=1)))
    assert {condition.name: condition.value for condition in table.conditions}["path_length"] == pytest.approx(
        length, abs=1e-3
    )
    for comparison in table.comparisons:
        shares = dict(comparison.also)
        assert shares["ours_percent_of_path_length"] == pytest.approx(0.1 * float(comparison.ours) / length, rel=1e-3)
        assert shares["printed_percent_of_implied_path"] == pytest.approx(
            0.1 * float(comparison.printed) / 5.73, abs=0.006
        )
    (note,) = (note for note in table.notes if "%" in note)
    assert f"of the {length:.3f} m that were driven" in note
    assert "Printed, of the 5.7" in note


@pytest.mark.parametrize(
    ("change", "seconds"),
    [
        ({}, 4 * (1.5 / 0.25 + 0.25 / 0.5) + 4 * (2.0 + 0.5)),
        ({"speed": 0.2}, 4 * (1.5 / 0.2 + 0.2 / 0.5) + 4 * 2.5),
        ({"acceleration": 0.25}, 4 * (6.0 + 1.0) + 4 * 2.5),
        ({"turn_rate": 30.0}, 4 * 6.5 + 4 * (3.0 + 1 / 3)),
        ({"turn_acceleration": 45.0}, 4 * 6.5 + 4 * (2.0 + 1.0)),
        ({"corners": "fixed"}, 4 * 6.5),
    ],
)
def test_speeds_and_accelerations_are_those_of_the_drive(change, seconds):
    assumed = Assumptions(**change)
    assert assumed.square("cw").duration == pytest.approx(seconds)
    assert rolled_square(assumed, "cw").t[-1] == pytest.approx(seconds, abs=0.0501)


def test_other_robots_seeds_and_distributions_have_other_errors():
    variants = (
        Assumptions(),
        Assumptions(robot="asoc-full-scale"),
        Assumptions(seed=1),
        Assumptions(distribution="normal"),
        Assumptions(speed=0.2),
        Assumptions(runs=1),
    )
    found = [errors_of_sets(Conditions(assumed, sets=2), CALIBRATED)["CAST-0"] for assumed in variants]
    assert len({float(value) for errors in found for value in errors}) == 2 * len(variants)


def test_relative_errors_turn_a_larger_base_less():
    """Without corners to turn at, heading errors are those of the sides: rolled distance over the base's width."""
    small, large = (
        mean_errors(Conditions(Assumptions(robot=robot, runs=1, corners="fixed"), sets=60), UNCALIBRATED)["CAST-0"].mean
        for robot in ("asoc-prototype", "asoc-full-scale")
    )
    assert large < 0.8 * small


def test_printed_percentages_are_of_one_path():
    for row in TABLE_2.values():
        for error, share in row.values():
            low, high = (0.1 * error / (share + half) for half in (0.005, -0.005))
            assert low < 5.73 < high


def test_json_has_ratios_and_standard_errors_and_claims_no_agreement(castor_bench):
    code, out, err = castor_bench("tables", "--table", "doebbler-2", "--sets", 2, "--json")
    assert (code, err) == (0, "")
    data = json.loads(out)
    (table,) = data["tables"]
    assert "failure_modes" not in data
    assert table["agreement"] == {}
    assert len(table["values"]) == 6 * len(COLUMNS)
    first = table["values"][0]
    assert (first["simulation"], first["robot_file"], first["estimator"]) == ("honest-arc", "uncalibrated", "IPEC-1")
    assert first["ratio"] == pytest.approx(first["ours_mm"] / first["printed_mm"])
    assert first["standard_error_mm"] > 0
    assert "agrees" not in first


def test_the_table_shows_print_beside_every_simulation(castor_bench):
    code, out, err = castor_bench("tables", "--table", "doebbler-2", "--sets", 2)
    assert (code, err) == (0, "")
    for row in TABLE_2.values():
        for error, _ in row.values():
            assert out.count(f" {error:.1f} | ") == len(COLUMNS)
    assert "nothing here is tuned to print" in out
    assert "printed 5.5 / 5.5 / 8.0, 1.27 / 1.84" in out
    assert "Where the metrics fail" not in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--table", "doebler-2"), "error: unknown table 'doebler-2'; did you mean 'doebbler-2'?\n"),
        (("--sets", 1), "error: --sets must lie between 2 and 100000, got 1\n"),
    ],
)
def test_mistakes_are_reported_in_one_line(castor_bench, arguments, message):
    assert castor_bench("tables", *arguments) == (2, "", message)
