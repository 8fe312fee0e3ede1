"""What wheels and castors cannot have done is said of an import: counters that wrap, resets, wrong readings."""

import dataclasses
import re

import numpy as np
import pytest

from castor_envs.logs import ChannelMap, import_log
from castor_envs.logs.columns import LogColumns
from castor_envs.vehicles.presets import preset

ROBOT = dataclasses.replace(preset("differential"), sample_period=0.02, max_wheel_speed=15.0)
PER_RADIAN = (ROBOT.wheels[0].counts_per_rev or 0) / (2 * np.pi)
T = 0.02 * np.arange(501)
COUNTS = np.round((4 * T + np.sin(T)) * PER_RADIAN)


def notes(folder, left, t=T, name="left", **column):
    """Return what is said of the left wheel, of a channel's name; the right one has the counts of a drive."""
    rows = (",".join(map(repr, row)) for row in zip(t.tolist(), left.tolist(), COUNTS.tolist(), strict=True))
    (folder / "run.csv").write_text("\n".join([f"t,{name},right", *rows]) + "\n")
    columns = {
        "wheel_1l": {"channel": name, "unit": "counts"} | column,
        "wheel_1r": {"channel": "right", "unit": "counts"},
    }
    by = ChannelMap.from_dict({"format": "castor-map/1", "sources": {"main": {"time": "t"}}, "columns": columns})
    return [note for note in import_log(folder / "run.csv", ROBOT, by).notes if note.startswith("wheel_1l: ")]


@pytest.mark.parametrize(
    ("value", "column", "period"),
    [
        (COUNTS % 4096, {}, 4096),
        (-COUNTS % 4096, {"sign": -1}, 4096),
        (COUNTS * 30 % 65536 * 2, {"scale": 1 / 60}, 131072),
        (COUNTS * 30 % 65536, {"scale": 1 / 30}, 65536),
        *((np.mod(COUNTS - COUNTS[250], 2.0**bits), {}, 2**bits) for bits in (20, 24, 32)),
        (COUNTS / PER_RADIAN % (2 * np.pi), {"unit": "rad"}, 2 * np.pi),
        (np.degrees(COUNTS / PER_RADIAN) % 360, {"unit": "deg"}, 360),
        (COUNTS / PER_RADIAN / (2 * np.pi) % 1, {"unit": "rev"}, 1),
    ],
)
def test_a_counter_that_wraps_is_said_and_where(tmp_path, value, column, period):
    """The number in the note can be taken over as it is: with it, the counter goes on."""
    (said,) = notes(tmp_path, value, **column)
    asked, added = re.findall(r'wrap at (\S+)\? add "wraps_at": (\S+) to the map', said)[0]
    assert asked == added
    assert float(added) == pytest.approx(period, rel=1e-11)
    assert notes(tmp_path, value, **column, wraps_at=float(added)) == []


def test_an_encoder_that_never_moves_is_said(tmp_path):
    assert notes(tmp_path, 0 * COUNTS + 7) == ["wheel_1l: 'left' never changes: is it the right channel?"]
    assert notes(tmp_path, 0 * COUNTS, unit="rad/s") == ["wheel_1l: 'left' never changes: is it the right channel?"]


@pytest.mark.parametrize(
    ("name", "unit", "said"),
    [
        ("velocity[left_drive_joint]", "rad", True),
        ("left speed", "m", True),
        ("velocity[left_drive_joint]", "rad/s", False),
        ("left speed", "counts/row", False),
        ("/speeds position[left]", "rad", False),
        ("left", "rad", False),
    ],
)
def test_a_speed_in_the_unit_of_an_angle_or_a_way_is_said(tmp_path, name, unit, said):
    question = f"wheel_1l: {name!r} is a speed by its name, {unit!r} is none: are channel and unit right?"
    assert (question in notes(tmp_path, COUNTS / PER_RADIAN, name=name, unit=unit)) == said


def test_a_reset_and_a_wrong_reading_are_said_with_their_time_and_size(tmp_path):
    reset, wrong, coarse = COUNTS.copy(), COUNTS.copy(), np.round(COUNTS / 200)
    reset[300:] -= COUNTS[300]
    wrong[200] = 0
    step = reset[300] - reset[299]
    assert notes(tmp_path, reset) == [
        f"wheel_1l: jumps by {step:.6g} counts after 5.980 s of the log: was it reset, or a reading wrong? cut the "
        "recording there, or blank the reading"
    ]
    (said,) = notes(tmp_path, wrong)
    assert f"jumps by {-COUNTS[199]:.6g} counts after 3.980 s of the log, and 1 more" in said
    assert notes(tmp_path, coarse) == []


def test_readings_that_were_held_up_and_gaps_are_no_jumps(tmp_path):
    """Every second a tenth of the readings comes at once, 0.1 ms apart; or a tenth of the drive is missing."""
    k = np.arange(501)
    late = np.where(k % 50 < 5, T[k - k % 50] + 0.09 + 1e-4 * (k % 50), T)
    assert notes(tmp_path, COUNTS, late) == []
    gap = np.where(T > 5, T + 1.0, T)
    assert notes(tmp_path, COUNTS + np.where(T > 5, np.round(4 * PER_RADIAN), 0), gap) == []


POWERED = dataclasses.replace(preset("powered-caster"), sample_period=0.02)
TURN = POWERED.castors[0].pivot_counts_per_rev or 0.0
ANGLE = 6 * T + 2 * np.sin(3 * T)
"""rad: a castor that goes round and round, at up to 12 rad/s."""


def pivot_notes(folder, angle, unit="rad", **column):
    """Return what is said of the first pivot with these readings; wheels and the others have those of a drive."""
    columns = LogColumns.of(POWERED)
    first, *others = columns.pivot
    values = dict.fromkeys((*columns.wheel, *others), np.sin(T)) | {first: angle}
    rows = (",".join(map(repr, row)) for row in zip(T.tolist(), *(v.tolist() for v in values.values()), strict=True))
    (folder / "run.csv").write_text("\n".join([",".join(("t", *values)), *rows]) + "\n")
    mapped = {key: {"channel": key, "unit": "rad"} for key in values}
    mapped[first] |= {"unit": unit} | column
    by = ChannelMap.from_dict({"format": "castor-map/1", "sources": {"main": {"time": "t"}}, "columns": mapped})
    return [note for note in import_log(folder / "run.csv", POWERED, by).notes if note.startswith(f"{first}: ")]


@pytest.mark.parametrize("angle", [ANGLE, ANGLE % (2 * np.pi), (ANGLE + np.pi) % (2 * np.pi) - np.pi, 0.1 * ANGLE])
def test_a_castor_that_turns_round_and_round_makes_no_jumps(tmp_path, angle):
    assert pivot_notes(tmp_path, angle) == []


def test_a_pivots_reset_and_wrong_reading_are_said_and_where_it_wraps(tmp_path):
    slow, reset = 0.3 * np.sin(T) + 1.5, ANGLE.copy()
    slow[200] = 0.0
    reset[300:] -= ANGLE[300]
    (wrong,) = pivot_notes(tmp_path, slow)
    assert f"jumps by {-slow[199]:.6g} rad after 3.980 s of the log, and 1 more: was it reset, or a read" in wrong
    (said,) = pivot_notes(tmp_path, reset)
    assert "after 5.980 s of the log: was it reset, or a reading wrong?" in said
    counts = np.round(ANGLE / (2 * np.pi) * 4 * TURN) % (4 * TURN)  # of an encoder with more than the robot file says
    (wraps,) = pivot_notes(tmp_path, counts, "counts")
    assert f'does it wrap at {4 * TURN:.0f}? add "wraps_at": {4 * TURN:.0f} to the map' in wraps


@pytest.mark.parametrize(
    ("time", "steps", "unit", "said"),
    [
        ("Zeit [ms]", 20, "s", "is the time 'Zeit [ms]' in ms, as its name says, not in s? mend"),
        ("clock", 20, "s", "is the time 'clock' in ms, not in s? mend"),
        ("clock", 0.02, "ms", "is the time 'clock' in s, not in ms? mend"),
        ("t_ns", 2e7, "us", "is the time 't_ns' in ns, as its name says, not in us? mend"),
        ("clock", 0.02 / 60, "s", "is the time 'clock' in min, not in s? mend"),
        ("clock", 0.1, "s", "mend that"),
        ("clock", 20, "ms", None),
    ],
)
def test_times_in_another_unit_than_the_map_says_are_said(tmp_path, time, steps, unit, said):
    """Only where no unit is mistaken is the robot file's sample period to be mended."""
    rows = (f"{steps * k},{left},{left}" for k, left in enumerate(COUNTS.tolist()))
    (tmp_path / "run.csv").write_text("\n".join([f"{time},left,right", *rows]) + "\n")
    columns = {f"wheel_1{side[0]}": {"channel": side, "unit": "counts"} for side in ("left", "right")}
    sources = {"main": {"time": time, "unit": unit}}
    by = ChannelMap.from_dict({"format": "castor-map/1", "sources": sources, "columns": columns})
    told = [note for note in import_log(tmp_path / "run.csv", ROBOT, by).notes if note.startswith("rows come")]
    assert len(told) == (said is not None)
    assert all(
        said in note and (("sample_period is 0.02 s: mend that" in note) == (said == "mend that")) for note in told
    )


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ("/tf odom>base_link.{}", True),
        ("/amcl_pose pose.pose.{}", True),
        ("/vicon/odom pose.{}", False),
        ("/tf map>marker.{}", False),
    ],
)
def test_a_reference_that_the_robot_computed_itself_is_said(tmp_path, pose, said):
    names = {"ref_x": pose.format("x"), "ref_y": pose.format("y"), "ref_psi": pose.format("heading")}
    rows = (f"{t},{n},{n},{0.001 * k},0,0" for k, (t, n) in enumerate(zip(T.tolist(), COUNTS.tolist(), strict=True)))
    (tmp_path / "run.csv").write_text("\n".join([",".join(("t", "left", "right", *names.values())), *rows]) + "\n")
    columns = {f"wheel_1{side[0]}": {"channel": side, "unit": "counts"} for side in ("left", "right")}
    columns |= {key: {"channel": name, "unit": "rad" if key == "ref_psi" else "m"} for key, name in names.items()}
    by = ChannelMap.from_dict({"format": "castor-map/1", "sources": {"main": {"time": "t"}}, "columns": columns})
    told = [
        note for note in import_log(tmp_path / "run.csv", ROBOT, by).notes if note.startswith("ref_x, ref_y, ref_psi")
    ]
    assert len(told) == said
    assert all(f"{names['ref_x']!r} is the robot's own pose by its name, which is no reference" in one for one in told)
