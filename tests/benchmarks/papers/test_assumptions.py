"""What Doebbler's tables assume: options with default and reason, impossible values, and what is shown."""

import dataclasses
import json

import pytest

from benchmarks.papers.assumptions import Assumptions, option_name
from castor_envs.effects.dimensions import PivotBias
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import preset

NAMES = tuple(field.name for field in dataclasses.fields(Assumptions))


def test_every_assumption_is_an_option_with_default_and_reason(castor_bench, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.setenv("TERM", "dumb")
    code, out, _ = castor_bench("tables", "--help")
    assert code == 0
    for name in NAMES:
        text = " ".join(out[out.index(f"{option_name(name)} ") :].partition(" --")[0].split())
        assert "Reason: " in text
        assert f"[default: {getattr(Assumptions(), name)}" in text


def test_json_holds_all_conditions_and_people_read_the_changed_ones(castor_bench):
    arguments = ("tables", "--table", "doebbler-2", "--sets", 2, "--corners", "rounded", "--runs", 2, "--speed", 0.2)
    code, out, err = castor_bench(*arguments, "--json")
    assert (code, err) == (0, "")
    (table,) = json.loads(out)["tables"]
    length = table["conditions"].pop("path_length_m")
    assert length == pytest.approx(5.727, abs=1e-3)
    assert table["conditions"] == {
        "sets": 2,
        "robot": "asoc-prototype",
        "speed_m_s": 0.2,
        "acceleration_m_s2": 0.5,
        "corners": "rounded",
        "corner_radius_m": 0.159,
        "distribution": "uniform",
        "runs": 2,
        "seed": 0,
        "side_m": 1.5,
        "sample_period_s": 0.05,
    }
    for value in table["values"]:
        assert value["ours_percent_of_path_length"] == pytest.approx(0.1 * value["ours_mm"] / length)
    _, out, _ = castor_bench(*arguments)
    assert (
        "Changed conditions: sets 2 (default 1000), speed 0.2 m/s (default 0.25), corners rounded (default turn), "
        "runs 2 (default 5). --json shows all of them, castor-bench tables --help their reasons." in out
    )


def test_tables_without_assumptions_show_none(castor_bench):
    _, out, _ = castor_bench("tables", "--table", "vogt-1")
    assert "onditions" not in out
    _, out, _ = castor_bench("tables", "--table", "vogt-1", "--json")
    assert "conditions" not in json.loads(out)["tables"][0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--corners", "round"), "unknown corners 'round'; known: turn, fixed, rounded"),
        (("--distribution", "flat"), "unknown distribution 'flat'; known: uniform, normal"),
        (("--speed", 0), "speed must lie between 0.05 and 5 m/s, got 0"),
        (("--acceleration", "inf"), "acceleration must lie between 0.01 and 50 m/s2, got inf"),
        (("--turn-rate", "nan"), "turn rate must lie between 5 and 720 deg/s, got nan"),
        (("--turn-acceleration", -90), "turn acceleration must lie between 1 and 7200 deg/s2, got -90"),
        (("--runs", 0), "runs must lie between 1 and 100, got 0"),
        (("--turns", 0), "turns must lie between 1 and 100, got 0"),
        (("--distance-error", 0), "distance error must lie between 0.001 and 10 %, got 0"),
        (("--robots", 1), "robots must lie between 2 and 1000, got 1"),
        (("--seed", -1), "seed must lie between 0 and 1000000000, got -1"),
        (
            ("--corners", "rounded", "--corner-radius", 0.75),
            "corner radius must lie between 0.01 and 0.735 m, got 0.75",
        ),
        (("--corner-radius", 0.2), "corner radius matters to corners 'rounded' alone, and these are 'turn'"),
        (
            ("--corners", "fixed", "--turn-rate", 30),
            "turn rate matters to corners 'turn' alone, and these are 'fixed'",
        ),
        (
            ("--turns", 2, "--table", "doebbler-2", "--table", "vogt-1"),
            "--turns changes nothing in doebbler-2, vogt-1; castor-bench tables --help says what it is for",
        ),
        (
            ("--robot", "4-castor"),
            "robot 4-castor: Doebbler's Tables II and III leave out one castor of three, and it has 4; choose another, "
            "or --table doebbler-1",
        ),
        (("--robot", "asoc-prototyp"), "unknown robot or train 'asoc-prototyp'; did you mean 'asoc-prototype'?"),
        (("--robot", "none.json"), "none.json: cannot be read (No such file or directory)"),
        (
            ("--speed", 1),
            "robot asoc-prototype: its wheels reach 20 rad/s, and the square asks for 22.6; choose a lower speed or "
            "turn rate, or a larger corner radius",
        ),
    ],
)
def test_impossible_values_are_one_clear_line(castor_bench, arguments, message):
    assert castor_bench("tables", "--sets", 2, *arguments) == (2, "", f"error: {message}\n")


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ("differential", "castor 1 must turn freely and have a pivot encoder"),
        ("swerve", "castor 1 must turn freely and have a pivot encoder"),
        ("1-castor", "needs two castors or more"),
    ],
)
def test_other_kinds_of_robots_are_refused(robot, message):
    with pytest.raises(InputError, match=message):
        Assumptions(robot=robot)


def test_castors_need_a_driven_wheel_on_either_side_and_no_effects(tmp_path):
    base = preset("asoc-prototype")
    first, *remaining = base.castors
    left, right = first.wheels

    def refused(message, **changes):
        dataclasses.replace(base, **changes).save(tmp_path / "robot.json")
        with pytest.raises(InputError, match=message):
            Assumptions(robot=str(tmp_path / "robot.json"))

    def of_wheels(*wheels):
        return {"castors": (dataclasses.replace(first, wheels=wheels), *remaining)}

    refused("two driven wheels", **of_wheels(left))
    refused("two driven wheels", **of_wheels(left, dataclasses.replace(right, counts_per_rev=None)))
    refused("two driven wheels", **of_wheels(left, dataclasses.replace(right, grip="omni")))
    refused("either side", **of_wheels(left, dataclasses.replace(right, lateral=0.01)))
    refused("pivots apart", castors=(first, first, *remaining))
    refused("effects", effects=(PivotBias(castor=1, value=0.01),))


def test_a_robots_own_sample_period_gives_way_to_the_papers(tmp_path):
    dataclasses.replace(preset("asoc-prototype"), sample_period=0.01).save(tmp_path / "fast.json")
    assert Assumptions(robot=str(tmp_path / "fast.json")).base.sample_period == 0.05
