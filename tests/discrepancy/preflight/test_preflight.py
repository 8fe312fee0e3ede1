"""Gross mistakes, made on purpose in simulated and measured logs, and what the pre-flight says of them."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportAttributeAccessIssue=false

import dataclasses
import math
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from castor_envs.effects.catalogue import EFFECTS, catalogue, readings
from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.effects.encoders import PivotGain, TickLoss
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.logs.importers.optiodom import find_sessions, read_session
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.preflight import preflight
from discrepancy.preflight.checks import stops
from discrepancy.preflight.hypotheses import reading_of
from discrepancy.preflight.likelihood import USUAL, WiringLikelihood
from discrepancy.preflight.search import search
from discrepancy.trials.pymunk_generator import drive

WIRING = ("encoders_swapped", "encoder_reversed", "castor_order")
ASOC = preset("asoc-prototype")


def wiring_of(robot):
    return [effect for effect in catalogue(robot) if effect.name in WIRING]


@cache
def motion(robot, duration=24.0):
    """Perfect rolling at random; where fixed wheels stand on the x axis' line, without going sideways."""
    path = wander(np.random.default_rng(4), duration=duration)
    if any(castor.steering == "fixed" and castor.wheels[0].grip == "standard" for castor in robot.castors):
        runs = [
            dataclasses.replace(
                run, legs=tuple(dataclasses.replace(leg, motion=np.array(leg.motion) * [1, 0, 1]) for leg in run.legs)
            )
            for run in path.runs
        ]
        path = dataclasses.replace(path, runs=tuple(runs))
    return roll(robot, path)


def log_of(robot, *effects, poses=True, rolled=None):
    """The log of a robot that was moved by hand: effects are in its readings alone."""
    real = robot.with_effects(*effects)
    true = real.as_built()
    rolled = rolled or motion(true)
    wheel, castor = readings(real, rolled.t, rolled.wheel_angle, rolled.castor_angle)
    encoders = Encoders(Geometry.of(true), np.full(len(robot.driven_wheels), 0.4))
    reference = rolled.pose + np.random.default_rng(5).normal(size=rolled.pose.shape) * 1e-3
    reference[np.arange(len(reference)) % 10 > 0] = np.nan
    return Log(rolled.t, encoders.wheel(wheel), encoders.pivot(castor), reference=reference if poses else None)


def nearly_straight():
    """A way across the axes of the body, which does not turn."""
    legs = (Leg((0.65, 0.76, 0.0), 9.0),)
    return Trajectory("across", (Run(legs, speed=0.5, acceleration=0.5),))


def only(found):
    """The one mistake that was found."""
    assert len(found.mistakes) == 1, found
    return found.mistakes[0]


@pytest.mark.parametrize("name", ["asoc-prototype", "2-castor", "powered-caster", "tricycle", "omni3"])
def test_a_reading_undoes_the_effects_that_made_it(name):
    """Whatever two effects of wiring do to a log, a log that is read so contradicts nothing: the effects' own code
    made the log, the constraints judge it."""
    robot = preset(name)
    effects, random = wiring_of(robot), np.random.default_rng(6)
    assert effects
    for _ in range(6):
        made = [effects[k] for k in random.integers(len(effects), size=2)]
        misfit = WiringLikelihood(robot, [log_of(robot, *made)]).of(reading_of(robot, made))
        assert max(misfit.encoders, misfit.reference) < 2 * USUAL, made


def headless(log):
    """The log with positions alone."""
    return dataclasses.replace(log, reference=log.reference * [1.0, 1.0, np.nan])


@pytest.mark.parametrize("name", ["omnimate", "differential", "tricycle", "omni3"])
def test_wrong_wiring_is_found_by_positions_without_headings(name):
    """Each effect of wiring is told, or another that does the same to the robot; and nothing where there is none."""
    robot = preset(name)
    (said,) = preflight(robot, [headless(log_of(robot))]).remarks
    assert "has no headings" in said
    for effect in wiring_of(robot):
        found = preflight(robot, [headless(log_of(robot, effect))])
        assert only(found).effects == (effect,) or only(found).alternatives, effect


def test_units_and_axes_of_positions_are_found_and_no_headings_spoken_of():
    robot, log = preset("differential"), headless(log_of(preset("differential")))
    for factor, said in (((1000, 1000), "in millimetres"), ((100, 100), "in centimetres"), ((1, -1), "mirror")):
        seen = dataclasses.replace(log, reference=log.reference * [*factor, 1.0])
        mistake = only(preflight(robot, [seen]))
        told = [mistake.what, *mistake.alternatives]
        assert any(said in what for what in told), told
        assert not any("psi" in what for what in told), told


def test_a_robot_that_turns_below_its_receiver_contradicts_nothing():
    """Whose positions are noise alone, and tell of no wheel."""
    spin = Trajectory("spin", (Run((Leg((0.0, 0.0, 1.0), 12.0),), speed=0.6, acceleration=0.5),))
    robot = preset("differential")
    found = preflight(robot, [headless(log_of(robot, rolled=roll(robot, spin)))])
    assert not found.mistakes
    assert not any("contradict" in remark for remark in found.remarks)


def test_a_position_that_jumps_is_told():
    log = headless(log_of(ASOC))
    jumped = log.reference.copy()
    jumped[200:, :2] += 0.3
    found = preflight(ASOC, [dataclasses.replace(log, reference=jumped)])
    assert not found.mistakes
    assert any("the reference jumps" in remark for remark in found.remarks)


@pytest.mark.parametrize("poses", [True, False], ids=["reference", "no-reference"])
@pytest.mark.parametrize("effect", wiring_of(ASOC), ids=lambda effect: "-".join(map(str, dataclasses.astuple(effect))))
def test_wrong_wiring_is_named(effect, poses):
    found = preflight(ASOC, [log_of(ASOC, effect, poses=poses)])
    mistake = only(found)
    assert mistake.effects == found.effects == (effect,)
    assert mistake.alternatives == ()
    assert not found.fatal
    assert any("scale is not observable" in remark for remark in found.remarks) is not poses


@pytest.mark.parametrize("kind", sorted(set(EFFECTS) - set(WIRING)))
def test_small_effects_are_no_mistakes(kind):
    """Ten steps are a percent, 10 mrad, 10 ms, a millimetre."""
    for effect in EFFECTS[kind].variants(ASOC)[:1]:
        value = effect.value if kind == "lost_remainders" else 10 * effect.value
        real = dataclasses.replace(effect, value=value)
        found = preflight(ASOC, [log_of(ASOC, real)])
        assert found.mistakes == ()
        assert found.remarks == ()


@pytest.mark.parametrize("name", ["asoc-prototype", "omnimate", "differential", "tricycle", "swerve", "omni3"])
def test_a_robot_in_good_order_has_no_mistake(name):
    found = preflight(preset(name), [log_of(preset(name))])
    assert found.mistakes == ()
    assert found.remarks == ()


def test_castors_shifted_around_are_put_in_order():
    effects = (CastorOrder(castor=1, exchanged_with=2), CastorOrder(castor=2, exchanged_with=3))
    log = log_of(ASOC, *effects)
    mistake = only(preflight(ASOC, [log]))
    assert "order" in mistake.what
    assert reading_of(ASOC, mistake.effects) == pytest.approx(reading_of(ASOC, effects))


@pytest.mark.parametrize(
    "effects",
    [
        (EncodersSwapped(castor=1), EncoderReversed(castor=3, wheel=2)),
        (EncoderReversed(castor=1), EncodersSwapped(castor=2)),
        (EncoderReversed(castor=2, wheel=1), EncoderReversed(castor=3)),
    ],
)
def test_two_mistakes_at_once_are_both_named(effects):
    found = preflight(ASOC, [log_of(ASOC, *effects)])
    assert set(found.effects) == set(effects)
    assert [mistake.alternatives for mistake in found.mistakes] == [(), ()]


def counted(log, wheels, factor):
    wheel = log.wheel.copy()
    wheel[:, wheels] = np.round(factor * wheel[:, wheels])
    return dataclasses.replace(log, wheel=wheel)


@pytest.mark.parametrize(
    ("wheels", "factor", "said"),
    [
        ([3], 4.0, "counts of wheel_2r are 4 times"),
        ([4, 5], 0.5, "counts of the wheels of castor 3 are 0.5 times"),
        (slice(None), 10.0, "counts of all wheels are 10 times"),
        (slice(None), 360 / 1200, "wheels are given in degrees"),
    ],
)
@pytest.mark.parametrize("poses", [True, False], ids=["reference", "no-reference"])
def test_counts_a_turn_that_are_wrong_by_a_factor_are_named(wheels, factor, said, poses):
    """Without reference too: how far castors trail gives the scale."""
    mistake = only(preflight(ASOC, [counted(log_of(ASOC, poses=poses), wheels, factor)]))
    assert said in mistake.what


@pytest.mark.parametrize(("turn", "unit"), [(360.0, "degrees"), (2 * np.pi, "radians")])
def test_pivots_in_other_units_than_counts_are_named(turn, unit):
    log = log_of(ASOC)
    found = preflight(ASOC, [dataclasses.replace(log, pivot=log.pivot * turn / 5143)])
    assert f"pivots are given in {unit}" in only(found).what
    assert found.fatal


@pytest.mark.parametrize(
    ("pivots", "factor", "said"), [([1], 2.0, "pivot_2 are 2"), ([0, 1, 2], 0.5, "all pivots are 0.5")]
)
def test_pivot_counts_a_turn_that_are_wrong_by_a_factor_are_named(pivots, factor, said):
    log = log_of(ASOC)
    pivot = log.pivot.copy()
    pivot[:, pivots] = np.round(factor * pivot[:, pivots])
    assert f"counts of {said} times" in only(preflight(ASOC, [dataclasses.replace(log, pivot=pivot)])).what


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((1000, 1000, 1), "ref_x and ref_y are in millimetres"),
        ((1, 1, 180 / np.pi), "ref_psi is in degrees"),
        ((1000, 1000, 180 / np.pi), "millimetres and degrees"),
        ((1e-3, 1e-3, 1), "ref_x and ref_y were in metres"),
        ((1, 1, np.pi / 180), "ref_psi was in radians"),
        ((1, 1, -1), "ref_psi runs clockwise"),
        ((1, -1, -1), "the reference is seen in a mirror"),
    ],
)
@pytest.mark.parametrize("name", ["asoc-prototype", "differential"])
def test_a_reference_in_other_units_or_senses_is_named(name, change, said):
    robot = preset(name)
    log = log_of(robot)
    found = preflight(robot, [dataclasses.replace(log, reference=log.reference * change)])
    mistake = only(found)
    assert any(said in sentence for sentence in (mistake.what, *mistake.alternatives))
    if robot is ASOC:
        assert said in mistake.what


def test_what_two_wheels_cannot_distinguish_is_reported():
    """Left for right, and left for right in the reference: the same log, for a robot with two wheels."""
    robot = preset("differential")
    mistake = only(preflight(robot, [log_of(robot, EncodersSwapped(castor=1))]))
    assert mistake.effects == (EncodersSwapped(castor=1),)
    assert any("mirror" in alternative for alternative in mistake.alternatives)
    blind = preflight(robot, [log_of(robot, EncodersSwapped(castor=1), poses=False)])
    assert (blind.mistakes, blind.blind) == ((), True)
    assert any("too few encoders and reference poses" in remark for remark in blind.remarks)


def test_a_wheel_reversed_on_the_spot_is_a_fork_turned_around():
    robot = preset("swerve")
    mistake = only(preflight(robot, [log_of(robot, EncoderReversed(castor=3, wheel=1))]))
    assert mistake.effects == (EncoderReversed(castor=3, wheel=1),)
    assert mistake.alternatives == ("pivot_3 reads half a turn too much",)


def test_a_turned_reference_is_reported_with_its_angle():
    log = log_of(ASOC)
    found = preflight(ASOC, [dataclasses.replace(log, reference=log.reference + np.array([0, 0, np.pi / 2]))])
    assert "points 90 degrees to the left" in only(found).what


@pytest.mark.parametrize("gain", [-0.05, 0.05])
def test_a_way_that_is_turned_by_a_wrong_pivot_is_no_mistake(gain):
    """Of a single castor's way that hardly bends, a mirror and a turn of the reference together would explain it."""
    robot = preset("1-castor")
    log = drive(robot.with_effects(PivotGain(castor=1, value=gain)), nearly_straight(), 4, duration=30.0)
    assert preflight(robot, [log]).mistakes == ()


@pytest.mark.parametrize("off", [-0.2, 0.2])
def test_a_module_that_is_toed_in_is_no_wrong_count(off):
    """Where a swerve's modules do not turn, a third or five thirds of the counts is the same error."""
    robot, ahead = preset("swerve"), Leg((np.cos(0.3), np.sin(0.3), 0.0), 9.0)
    rolled = roll(robot, Trajectory("ahead", (Run((ahead,), speed=0.5, acceleration=0.5),)))
    log = log_of(robot, PivotBias(castor=1, value=off), rolled=rolled)
    _, best, _ = search(robot, WiringLikelihood(robot, [log]))
    assert best.mistakes == ()


def test_wiring_is_named_in_logs_of_robots_steered_by_wrong_readings():
    for effect in (EncoderReversed(castor=2), CastorOrder(castor=1, exchanged_with=3)):
        motion = wander(np.random.default_rng([1, 1]), duration=20.0)
        log = drive(ASOC.with_effects(effect), motion, 1, duration=20.0)
        assert only(preflight(ASOC, [log])).effects == (effect,)


def test_a_mistake_that_stands_out_alone_is_reported_though_wheels_slide():
    """It leaves more than ten times what a robot in good order contradicts; any other leaves far more."""
    effect = CastorOrder(castor=1, exchanged_with=2)
    log = log_of(ASOC, effect)
    step = np.abs(np.diff(log.wheel, axis=0)).mean()
    slip = np.random.default_rng(1).normal(scale=0.45 * step, size=log.wheel.shape)
    sliding = dataclasses.replace(log, wheel=np.round(log.wheel + np.cumsum(slip, axis=0)))
    nominal, best, alike = search(ASOC, WiringLikelihood(ASOC, [sliding]))
    assert [mistake.effects for mistake in best.mistakes] == [(effect,)]
    assert alike == []
    assert 10 * USUAL < best.misfit.encoders < nominal.misfit.encoders / 2


def test_what_no_mistake_explains_is_reported_and_not_named():
    """Two wheels that turn at will."""
    log = log_of(ASOC)
    wheel = log.wheel.copy()
    wheel[:, 1:3] = np.round(np.cumsum(np.random.default_rng(1).normal(size=(len(log), 2)) * 40, axis=0))
    found = preflight(ASOC, [dataclasses.replace(log, wheel=wheel)])
    assert found.mistakes == ()
    assert any("no mistake of wiring or units alone" in remark for remark in found.remarks)


def test_a_channel_that_wrongly_stands_still_is_a_mistake():
    log = log_of(ASOC)
    for part, column, name in (("wheel", 2, "wheel_2l"), ("pivot", 1, "pivot_2")):
        counts = getattr(log, part).copy()
        counts[:, column] = 7.0
        found = preflight(ASOC, [dataclasses.replace(log, **{part: counts})])
        assert only(found).what.startswith(f"{name} never changes, although")
        assert found.fatal


def test_a_channel_that_stops_on_the_way_is_a_mistake():
    log = log_of(ASOC)
    for part, column, name in (("wheel", 2, "wheel_2l"), ("pivot", 1, "pivot_2")):
        counts = getattr(log, part).copy()
        counts[200:, column] = counts[200, column]
        found = preflight(ASOC, [dataclasses.replace(log, **{part: counts})], ["a.csv"])
        assert only(found).what.startswith(
            f"a.csv: {name} never changes after row 201 (t {log.t[200]:.6g} s), although"
        )
        assert found.fatal


@pytest.mark.parametrize("effect", [WheelRadius(castor=1, wheel=1, value=0.08), PivotBias(castor=1, value=0.05)])
def test_another_fault_beside_a_pivot_that_stands_still_is_no_stop(effect):
    """A swerve drives straight in the second half, its pivots still: what contradicts did so before, too."""
    swerve = preset("swerve")
    ways = [Leg((math.cos(0.7 * k), math.sin(0.7 * k), 0.4 * (-1) ** k), 0.8) for k in range(6)] + [
        Leg((1.0, 0.0, 0.0), 5.0)
    ]
    course = Trajectory("ways", tuple(Run((way,), 0.4, 0.5) for way in ways))
    log = drive(swerve.with_effects(effect), course, 1, duration=course.duration)
    log = dataclasses.replace(log, command=None, steering_command=None)
    assert 0 in stops(log)
    assert not any("never changes" in mistake.what for mistake in preflight(swerve, [log]).mistakes)


def test_exchanged_encoders_beside_a_wheel_that_stands_still_are_no_stop():
    differential = preset("differential")
    about = Trajectory("about", tuple(Run((Leg(way, 2.0),), 0.3, 0.5) for way in ((1.0, 0.0, 0.3), (0.17, 0.0, -1.0))))
    found = preflight(differential, [log_of(differential, EncodersSwapped(castor=1), rolled=roll(differential, about))])
    assert found.effects == (EncodersSwapped(castor=1),)


def test_a_robot_that_stops_or_turns_about_a_wheel_has_no_mistake():
    differential, asoc = preset("differential"), log_of(ASOC)
    rest = {part: getattr(asoc, part).copy() for part in ("wheel", "pivot", "reference")}
    for values in rest.values():
        values[200:] = values[200]
    assert preflight(ASOC, [dataclasses.replace(asoc, **rest)]).mistakes == ()
    about = Trajectory("about", tuple(Run((Leg(way, 2.0),), 0.3, 0.5) for way in ((1.0, 0.0, 0.0), (0.17, 0.0, -1.0))))
    rolled = roll(differential, about)
    assert np.ptp(rolled.wheel_angle[-100:, 0]) > 10 * np.ptp(rolled.wheel_angle[-100:, 1])
    assert preflight(differential, [log_of(differential, rolled=rolled)]).mistakes == ()


def test_a_counter_that_wraps_is_reported_with_size_and_place():
    log = log_of(ASOC)
    wheel = log.wheel.copy()
    wheel[:, 3] = np.mod(wheel[:, 3], 1024)
    found = preflight(ASOC, [dataclasses.replace(log, wheel=wheel)], ["a.csv"])
    first = int(np.flatnonzero(np.abs(np.diff(wheel[:, 3])) > 512)[0]) + 2
    assert only(found).what.startswith("a.csv: wheel_2r wraps at 1024 (10 bits)")
    assert f"first in row {first} " in only(found).what


@pytest.mark.parametrize(
    ("in_s", "said", "remedy"),
    [(1e-3, "milliseconds", "divide t by 1000"), (86400.0, "days", "multiply t by 86400")],
)
def test_times_in_another_unit_are_a_mistake(in_s, said, remedy):
    log = log_of(ASOC)
    found = preflight(ASOC, [dataclasses.replace(log, t=log.t / in_s)])
    assert f"t is in {said}, not in s" in only(found).what
    assert only(found).what.endswith(remedy)


def test_nan_is_reported_with_its_place():
    log = log_of(ASOC)
    wheel = log.wheel.copy()
    wheel[7, 2] = np.nan
    found = preflight(ASOC, [dataclasses.replace(log, wheel=wheel)])
    assert "column 'wheel_2l', row 8: nan" in only(found).what


def test_gaps_dropouts_and_jumps_are_remarks_with_their_rows():
    log = log_of(ASOC)
    keep = np.r_[0:200, 230 : len(log)]
    parts = {name: getattr(log, name)[keep] for name in ("t", "wheel", "pivot", "reference")}
    parts["reference"][300:] += [0.5, 0, 0]
    parts["reference"][30:80] = np.nan
    wheel = parts["wheel"]
    wheel[120:, 4] += 700
    found = preflight(ASOC, [Log(**parts)])
    assert found.mistakes == ()
    told = "\n".join(found.remarks)
    assert "1 gap between samples: 1.55 s after row 200" in told
    assert "the reference drops out 2 times: 3 s after row 21" in told
    assert "wheel_3l jumps once, faster than the robot can" in told
    assert "in row 121 " in told
    assert "the reference jumps" in told


def test_a_reference_that_repeats_poses_while_wheels_turn_is_remarked():
    log = log_of(ASOC, poses=False)
    pose = motion(ASOC).pose[: len(log)] + 0.0
    assert not any(
        "the reference" in remark for remark in preflight(ASOC, [dataclasses.replace(log, reference=pose)]).remarks
    )
    held, frozen = pose[np.arange(len(pose)) // 4 * 4], pose.copy()
    frozen[100:141] = pose[100]
    said = [preflight(ASOC, [dataclasses.replace(log, reference=of)]).remarks for of in (held, frozen)]
    assert "log: the reference stands in 4 rows or so with each pose" in "".join(said[0])
    place = f"repeats a pose while wheels turn once: for 2 s after row 101 (t {log.t[100]:.6g} s)"
    assert place in "".join(said[1])


def test_a_robot_that_is_back_at_its_start_repeats_no_pose():
    log = log_of(ASOC, poses=False)
    ends = np.full((len(log), 3), np.nan)
    ends[[0, -1]] = 0.0
    remarks = preflight(ASOC, [dataclasses.replace(log, reference=ends)]).remarks
    assert not any("the reference stands" in remark or "repeats a pose" in remark for remark in remarks)


def test_counts_that_need_not_be_whole_are_not_remarked():
    """Of pivots whose counts a turn are not whole, as recorded; and of angles and metres, as imported."""
    castors = [dataclasses.replace(castor, pivot_counts_per_rev=4095.7) for castor in ASOC.castors]
    geared = dataclasses.replace(ASOC, castors=tuple(castors))
    log = log_of(geared)
    assert np.any(log.pivot != np.round(log.pivot))
    assert preflight(geared, [log]).remarks == ()
    rolled, geometry = motion(ASOC), Geometry.of(ASOC)
    exact = rolled.wheel_angle[:, np.array(ASOC.driven_wheels)] * 1200 / (2 * np.pi)
    turns = (rolled.castor_angle + geometry.pivot_zero) / (2 * np.pi)
    imported = dataclasses.replace(log_of(ASOC), wheel=exact, pivot=turns * geometry.pivot_counts_per_rev)
    assert {wheel.counts_per_rev for wheel in ASOC.wheels} == {1200}
    assert preflight(ASOC, [imported]).remarks == ()


def test_angles_that_stand_for_counts_are_remarked():
    rolled = motion(ASOC)
    angles = {"wheel": rolled.wheel_angle, "pivot": np.remainder(rolled.castor_angle, 2 * np.pi)}
    remarks = preflight(ASOC, [dataclasses.replace(log_of(ASOC), **angles)]).remarks
    (told,) = [remark for remark in remarks if "as small as angles in rad; give counts" in remark]
    assert told.startswith("the log: pivot_1, pivot_2, pivot_3, wheel_1l, wheel_1r, wheel_2l")


@pytest.mark.parametrize("rows", [2, 3, 9, 40])
def test_short_and_still_logs_are_reported_and_nothing_is_named(rows):
    log = log_of(ASOC)
    short = Log(*(getattr(log, name)[:rows] for name in ("t", "wheel", "pivot")))
    still = dataclasses.replace(log, wheel=log.wheel * 0, pivot=log.pivot * 0)
    for checked, said in ((short, "little is observable"), (still, "nothing moves")):
        found = preflight(ASOC, [checked])
        assert found.mistakes == ()
        assert any(said in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("effect", "likeliest"),
    [
        (WheelRadius(castor=2, wheel=1, value=0.05), ""),
        (WheelRadius(castor=2, wheel=1, value=-0.2), "the counts of wheel_2l are 1.2"),
        (TickLoss(castor=3, wheel=2, value=0.32, above=1.0), "the counts of wheel_3r are 0."),
    ],
)
def test_what_is_no_gross_mistake_is_a_remark(effect, likeliest):
    found = preflight(ASOC, [log_of(ASOC, effect)])
    assert found.mistakes == ()
    assert any(remark.startswith(f"the likeliest: {likeliest}") for remark in found.remarks) == bool(likeliest)


def measured():
    root = Path(os.environ.get("CASTOR_DATA", ""))
    if not os.environ.get("CASTOR_DATA") or not (root / "optiodom").is_dir():
        pytest.skip("the measured data are absent: CASTOR_DATA names no folder that holds optiodom/")
    return [read_session(folder) for folder in find_sessions(root).values()]


def test_measured_logs_hold_no_mistake():
    for session in measured():
        for runs in (session.runs, session.runs[:1]):
            assert preflight(session.robot, runs).mistakes == (), session.name


def test_mistakes_made_in_measured_logs_are_found():
    """Columns exchanged or reversed; on robots without redundancy others may explain it as well."""
    kinds = {session.type: session for session in measured()}
    for session in kinds.values():
        for effect in wiring_of(session.robot):
            wrong = []
            for run in session.runs:
                wheel, pivot = run.wheel.copy(), run.pivot.copy()
                match effect:
                    case EncodersSwapped():
                        wheel = wheel[:, ::-1]
                    case EncoderReversed(wheel=None):
                        pivot = -pivot
                    case EncoderReversed():
                        wheel[:, effect.wheel - 1 if session.robot.castors[0].wheels[1:] else effect.castor - 1] *= -1
                    case _:
                        a, b = effect.castor - 1, effect.exchanged_with - 1
                        wheel[:, [a, b]] = wheel[:, [b, a]]
                wrong.append(dataclasses.replace(run, wheel=wheel, pivot=pivot))
            found = preflight(session.robot, wrong)
            assert found.effects == (effect,) or found.mistakes[0].alternatives, (session.name, effect, found)
