"""Pictures of a diagnosis: each is well formed, stands in the page alone, and shows what odometry and slip are."""

import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.report import pictures
from discrepancy.report.answers import html_of
from discrepancy.report.traces import Errors, Traces, along_the_way
from discrepancy.validation.replay import replay
from estimators.likelihood.log_likelihood import LogLikelihood

VOID = {"meta", "br", "hr", "img", "link", "input"}
ASOC = preset("asoc-prototype")
REAL = ASOC.with_effects(WheelRadius(castor=2, wheel=1, value=0.02))
LISTS = ("mistakes", "answers", "dimensions", "logs", "held_out_logs", "clean_logs", "preflight", "effects")
UNKNOWN = ("gap", "held_out_gap", "clean_gap", "noise", "replay", "where")
DATA = {"robot": "base", "verdict": "named", "names": {}, "probabilities": {}}
DATA |= {key: [] for key in LISTS} | dict.fromkeys(UNKNOWN)


class Reader(HTMLParser):
    """Reads a page, and fails where a tag is not closed."""

    def __init__(self):
        super().__init__()
        self.open, self.tags = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def read(page):
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert not reader.open
    return reader


@pytest.fixture(scope="module")
def drawn():
    """Pictures of a robot that rolls perfectly, on a file that lacks its effect."""
    geometry = Geometry.of(REAL.as_built())
    rolled = roll(REAL.as_built(), wander(np.random.default_rng(2), duration=12.0))
    encoders = Encoders(geometry, Encoders.random_phase(geometry, np.random.default_rng(0)))
    reference = rolled.pose.copy()
    reference[np.arange(len(reference)) % 20 > 0] = np.nan
    log = Log(rolled.t, encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle), reference=reference)
    return rolled, log


def traces(robot, log):
    geometry = Geometry.of(robot.as_built())
    return Traces(robot, log, LogLikelihood(geometry, log).start(geometry))


def curve(of, unit, knots):
    values = np.sin(np.arange(len(knots))) / 100
    heights = {"values": values.tolist(), "low": (values - 0.002).tolist(), "high": (values + 0.002).tolist()}
    return pictures.learned_curve("an encoder", {"of": of, "unit": unit, "knots": knots} | heights)


@pytest.mark.parametrize(
    ("of", "unit", "knots", "label"),
    [
        ("speed", "rad/s", [-4.0, 0.0, 2.0], "speed of the encoder's shaft"),
        ("own angle", "rad", [0.0, 2.0, 4.0], "angle of the encoder's shaft"),
        ("castor angle", "rad", [1.0, 2.0, 4.0], "angle of the castor"),
    ],
)
def test_a_learned_curve_is_drawn_against_what_it_depends_on(of, unit, knots, label):
    picture = curve(of, unit, knots)
    assert label in picture.alt
    assert label in picture.caption
    assert "degrees" in picture.alt or of == "speed"
    read(html_of(DATA, [picture]))


def errors(robot, log):
    geometry = Geometry.of(robot.as_built())
    model = LogLikelihood(geometry, log)
    state = model.start(geometry)
    return along_the_way(log, state, np.zeros(2), model.errors(geometry, np.zeros(2), np.zeros(3)))


def off_of(robot, log):
    """How far odometry is off the reference, along each axis, m."""
    return np.abs(errors(robot, log).off[:, :2])


def draw(log):
    before, after, wrong = traces(ASOC, log), traces(REAL, log), errors(ASOC, log)
    likely = [("wheel radius, castor 2, wheel 1", 0.9, "90 %"), ("<$x$ & y>", 0.1, "10 %")]
    shown = [
        pictures.probabilities(likely, ["wheel radius, castor 2, wheel 1"]),
        curve("own angle", "rad", [0.0, 2.0, 4.0]),
        pictures.drift({"these logs": ([wrong], [errors(REAL, log)]), "held-out logs": ([wrong], [])}),
        pictures.slip(before, after),
        pictures.floor(before),
        pictures.replays(replay(ASOC, log, 3.0), replay(REAL, log, 3.0)),
    ]
    return [picture for picture in shown if picture is not None]


@pytest.fixture(scope="module")
def svgs(drawn):
    return draw(drawn[1])


def test_a_page_with_all_pictures_is_well_formed_and_needs_nothing_else(svgs):
    page = html_of(DATA, svgs)
    reader = read(page)
    plain = re.sub(r"data:image/svg\+xml;base64,[\w+/=]*", "", page)
    assert not re.search(r"https?:|//[a-z]|@import|<script|<link", plain)
    assert not any(re.search(r"(href|src)=\"(?!#|data:)|url\((?!#)", picture.svg) for picture in svgs)
    pictured = [attributes for tag, attributes in reader.tags if tag == "img"]
    assert len(pictured) == len(svgs)
    assert all(attributes["src"].startswith("data:") and attributes["alt"] for attributes in pictured)


def test_pictures_are_well_formed_and_hold_what_they_refer_to(svgs):
    for picture in svgs:
        named = [element.get("id") for element in ElementTree.fromstring(picture.svg).iter()]
        ids = [name for name in named if name is not None]
        assert len(ids) == len(set(ids))
        referred = re.findall(r"url\(#([^)]*)\)", picture.svg) + re.findall(r'href="#([^"]*)"', picture.svg)
        assert set(referred) <= set(ids)


def test_the_same_logs_give_the_same_bytes(drawn, svgs):
    assert draw(drawn[1]) == svgs


def test_odometry_of_the_right_robot_follows_the_true_path(drawn):
    """Independent: the path was integrated from the motion, the counts from rolling on it; half a count is left."""
    assert off_of(REAL, drawn[1]).max() < 3e-4
    assert off_of(ASOC, drawn[1]).max() > 4e-3


def test_errors_are_drawn_against_the_way_that_was_driven(drawn):
    rolled, log = drawn
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rolled.pose[:, :2], axis=0).T))])
    assert errors(REAL, log).way == pytest.approx(driven[::20], abs=5e-3)
    picture = pictures.drift({"these logs": ([errors(ASOC, log)], [])})
    assert picture is not None
    rms = 1e3 * np.sqrt(np.mean(np.sum(errors(ASOC, log).off[:, :2] ** 2, axis=1)))
    assert f"these logs, {rms:.2f} mm rms" in picture.alt


def test_most_slip_is_on_the_wheel_that_is_too_large(drawn):
    """And what it slips is by how much its way is longer than described, where the poses are true."""
    rolled, log = drawn
    geometry, model = Geometry.of(ASOC), LogLikelihood(Geometry.of(ASOC), log)
    state = model.start(geometry)
    state[:, :3] = rolled.pose
    found = Traces(ASOC, log, state)
    assert found.worst()["channel"] == "wheel 2l rolling"
    row = found.channels.index("wheel 2l rolling")
    way = np.diff(np.interp([0.0, *(found.middle + 0.5)], log.t, rolled.wheel_angle[:, 2])) * geometry.radius[2]
    count = 2 * np.pi * geometry.radius[2] / geometry.counts_per_rev[2]
    assert found.slip[:-1, row] == pytest.approx(0.02 * way[:-1], abs=1.5 * count)


def test_pictures_of_one_robot_and_no_reference(drawn):
    blind = Log(drawn[1].t, drawn[1].wheel, drawn[1].pivot)
    alone = traces(ASOC, blind)
    assert pictures.drift({"these logs": ([Errors(np.zeros(0), np.zeros((0, 3)))], [])}) is None
    assert len(along_the_way(blind, np.zeros((len(blind), 3)), np.zeros(2), np.zeros((0, 3))).way) == 0
    drawn_of_it = pictures.slip(alone), pictures.floor(alone), pictures.replays(replay(ASOC, blind))
    read(html_of(DATA, [picture for picture in drawn_of_it if picture is not None]))
