"""What is allowed and hardly meant is remarked on, once, with its place; what people build is not."""

import dataclasses
import math
import re

import gymnasium
import pytest

import castor_envs  # noqa: F401
from castor_envs.errors import InputError
from castor_envs.vehicles.plausibility import remarks
from castor_envs.vehicles.presets import any_preset, cfmmr, preset, preset_names, train_names


def with_castor(robot, index=1, **changes):
    castors = list(robot.castors)
    castors[index] = dataclasses.replace(castors[index], **changes)
    return dataclasses.replace(robot, castors=tuple(castors))


def with_wheel(robot, **changes):
    left, right = robot.castors[1].wheels
    return with_castor(robot, wheels=(left, dataclasses.replace(right, **changes)))


@pytest.mark.parametrize("name", [*preset_names(), *train_names()])
def test_presets_are_plausible(name):
    assert remarks(any_preset(name)) == ()


ASOC = preset("asoc-prototype")
OUTSIDE = (dataclasses.replace(ASOC, center_of_mass=(2.0, 0.0)), "robot", "would lift")


@pytest.mark.parametrize(
    ("robot", "where", "what"),
    [
        (with_wheel(ASOC, radius=38.1), "wheel 2r", "radius 38.1 m is more than any robot has; .* meant: 0.0381"),
        (with_wheel(ASOC, radius=3.81e-5), "wheel 2r", "less than 2 mm"),
        (with_wheel(ASOC, lateral=-58.0), "wheel 2r", "lateral -58 m .* meant: -0.058"),
        (with_wheel(ASOC, counts_per_rev=1.0), "wheel 2r", "a count is 239 mm of floor"),
        (with_wheel(ASOC, radius=0.381), "wheel 2r", "is 10 times the smallest"),
        (with_castor(ASOC, pivot=(-120.0, 207.8)), "castor 2", "farther out than any robot's; .* 0.2078"),
        (with_castor(ASOC, offset=0.72), "castor 2", "18.9 wheel radii"),
        (with_castor(ASOC, offset=1e-4), "castor 2", "so short"),
        (with_castor(ASOC, pivot_zero=90.0), "castor 2", "if degrees were meant: 1.5708"),
        (with_castor(ASOC, pivot=(0.24, 0.0)), "castor 2", "where castor 1 has it"),
        (with_castor(ASOC, pivot_counts_per_rev=8), "castor 2", "45 degrees"),
        (with_castor(ASOC, pivot_counts_per_rev=None), "castor 2", "no pivot encoder"),
        (with_castor(preset("tricycle"), angle=90.0), "castor 2", "if degrees were meant"),
        (dataclasses.replace(ASOC, sample_period=50.0), "robot", "if milliseconds were meant: 0.05"),
        (dataclasses.replace(ASOC, max_wheel_speed=3000.0), "robot", "if turns a minute were meant: 314"),
        (dataclasses.replace(ASOC, inertia=500.0), "robot", "as if all mass were 5.27 m"),
        OUTSIDE,
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_slip_is_remarked_on_once_and_in_its_place(robot, where, what):
    (remark,) = [found for found in remarks(robot) if found.where == where]
    assert re.search(what, remark.what), remark.what


def test_what_environments_refuse_is_said_to_be_refused_by_them():
    (remark,) = remarks(OUTSIDE[0])
    said, _, follows = remark.what.rpartition("; ")
    assert follows == "until then environments and castor-bench drive refuse it, while logs of it can be read"
    with pytest.raises(InputError, match=re.escape(said)):
        gymnasium.make("castor/ASOC-v1", robot=OUTSIDE[0]).reset(seed=1)


def test_all_pivots_at_a_point():
    heaped = dataclasses.replace(ASOC, castors=tuple(dataclasses.replace(c, pivot=(0.0, 0.0)) for c in ASOC.castors))
    assert [found.where for found in remarks(heaped) if "all castors have their pivot" in found.what] == ["robot"]


def test_wheels_on_one_side_of_their_castor():
    left, right = ASOC.castors[0].wheels
    moved = with_castor(ASOC, 0, wheels=(left, dataclasses.replace(right, lateral=0.02)))
    assert "all wheels stand to one side" in next(found.what for found in remarks(moved) if found.where == "castor 1")


def test_a_robot_without_encoders():
    idle = [tuple(dataclasses.replace(w, counts_per_rev=None) for w in c.wheels) for c in ASOC.castors]
    castors = tuple(dataclasses.replace(c, wheels=w) for c, w in zip(ASOC.castors, idle, strict=True))
    assert "no wheel has an encoder" in remarks(dataclasses.replace(ASOC, castors=castors))[0].what


def test_modules_of_a_train_that_are_alike_are_remarked_on_once():
    train = cfmmr(3)
    wheels = tuple(dataclasses.replace(wheel, radius=75.0) for wheel in train.modules[0].wheels)
    odd = with_castor(train.modules[0], 0, wheels=wheels)
    found = remarks(dataclasses.replace(train, modules=(odd, odd, train.modules[2])))
    assert {remark.where for remark in found} == {"module 1, wheel 1l", "module 1, wheel 1r", "module 1, robot"}
    long = dataclasses.replace(train.frames[1], length=350.0)
    (remark,) = remarks(dataclasses.replace(train, frames=(train.frames[0], long)))
    assert remark.where == "frame B"
    assert math.isclose(float(remark.what.split(": ")[-1].rstrip(")")), 0.35)
