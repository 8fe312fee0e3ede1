"""The report is one well-formed page that needs nothing else, shows what was found, and trusts no file."""

import re
from html.parser import HTMLParser
from typing import Any

import pytest

from discrepancy.report import pictures
from discrepancy.report.page import html_of

VOID = {"meta", "br", "hr", "img", "link", "input"}

FINDING = {
    "effect": {"name": "wheel_radius", "castor": 2, "wheel": 1, "value": 0.00498123},
    "title": "wheel radius",
    "unit": "1",
    "standard_error": 0.00017,
    "interval": [0.00464803, 0.00531443],
    "check": "Measure the wheel's diameter under load.",
    "deviance": 858.2,
    "cost": {"m_per_10_m": 0.0093},
    "rivals": [{"what": "counts lost at speed, castor 2, wheel 1", "deviance": 612.3}],
}
SUMMARY = {
    "drive": "commands",
    "notes": ["the log has no steering commands: steering motors follow the pivots' counts"],
    "window_s": 5.0,
    "windows": 12,
    "windows_with_reference": 12,
    "driven_m": 8.1,
    "position_rms_mm": 8.24,
    "heading_rms_mrad": 8.26,
    "wheels_rms_mm": 1.63,
    "pivots_rms_mrad": None,
}
AFTER = SUMMARY | {"position_rms_mm": 2.06, "heading_rms_mrad": 1.57, "wheels_rms_mm": 0.09}
SLIP = {"odometry_rms_m": 0.0132, "odometry_rms_rad": 0.011, "slip_along_m": 2.1e-4, "slip_across_m": 8e-5}
DATA = {
    "format": "castor-diagnosis/1",
    "robot": "base",
    "logs": ["runs/monday.csv"],
    "verdict": "named",
    "reason": "wheel radius, castor 2, wheel 1",
    "findings": [FINDING],
    "preflight": ["pivot_2 is reversed"],
    "reference": {
        "mount": {"x_m": 0.0123, "y_m": -0.004, "psi_rad": 0.007},
        "clocks": [{"ahead_s": -0.0356, "rate": 2e-5}],
    },
    "gap": {"before": SLIP, "after": None},
    "gap_held_out": None,
    "replay": {"before": SUMMARY, "after": AFTER, "held_out_before": SUMMARY, "held_out_after": AFTER},
    "cannot_be_told_apart": ["wheel_radius 2 1"],
    "separating_motion": None,
    "where": {"channel": "wheel 2l rolling", "share_of_slip": 0.66, "at_s": 52.5, "x_m": 1.76, "y_m": 0.34},
    "robot_file": "out/robot.json",
    "candidates": [],
}


class Reader(HTMLParser):
    """Reads a page, and fails where a tag is not closed, or an id comes twice."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.tags, self.text = [], set(), [], []

    def handle_starttag(self, tag, attrs):
        named = dict(attrs).get("id")
        assert named is None or named not in self.ids, f"id {named} comes twice"
        self.ids.add(named)
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(page):
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert not reader.open
    return reader


def said(page):
    """What people see, in one line, without the data in full at the end."""
    text = " ".join(read(page).text)
    return re.sub(r"\s+", " ", text.partition("All that this page was made from")[0])


def test_nothing_from_a_file_is_taken_for_markup():
    evil = "<script>alert(1)</script>\"'&"

    def poisoned(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: poisoned(one) for key, one in value.items()}
        if isinstance(value, list):
            return [poisoned(one) for one in value]
        return evil if isinstance(value, str) else value

    page = html_of(
        poisoned(DATA | {"separating_motion": "x", "cannot_be_told_apart": ["a", "b"]}),
        [pictures.Picture("x", "<svg></svg>", evil, evil)],
    )
    assert "script" not in {tag for tag, _ in read(page).tags}
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_every_number_of_the_named_effect_is_shown_in_units_that_people_read():
    text = said(html_of(DATA))
    for number in ("+0.498", "0.033", "+0.465 to +0.531", "0.017", "858", "9.3", "mm per 10 m", "612", "0.00498123"):
        assert number in text
    assert FINDING["check"] in text
    assert "wheel radius, castor 2, wheel 1 (+0.498 ± 0.033 %)" in text


@pytest.mark.parametrize(
    ("unit", "value", "error", "shown"),
    [
        ("m", 0.00123, 0.00004, "+1.230 ± 0.078 mm"),
        ("rad", -0.0051, 0.0002, "−5.10 ± 0.39 mrad"),
        ("s", 0.01, 0.001, "+10.0 ± 2.0 ms"),
        ("s/s", 0.0123, 0.0001, "+0.01230 ± 0.00020 s/s"),
    ],
)
def test_digits_go_by_the_standard_error(unit, value, error, shown):
    finding = FINDING | {"unit": unit, "standard_error": error, "effect": {"name": "x", "value": value}}
    assert shown in said(html_of(DATA | {"findings": [finding]}))


def test_the_gap_stands_before_and_after_with_the_part_that_is_left():
    text = said(html_of(DATA))
    assert "position mm 8.24 2.06 25 % 8.24 2.06 25 %" in text
    assert "pivot counts" not in text  # never measured
    assert "slip along, 1 m mm 0.21" in text
    assert "Steering motors follow" not in text
    assert "The log has no steering commands" in text


def test_the_reference_is_reported_as_it_was_fitted():
    text = said(html_of(DATA))
    for number in ("+12.3 mm", "−4.0 mm", "+7.0 mrad", "−35.6 ms", "+0.02 ms/s"):
        assert number in text
    assert "no reference poses" in said(html_of(DATA | {"reference": None}))


@pytest.mark.parametrize("verdict", ["named", "ambiguous", "unconfirmed", "unexplained", "no discrepancy"])
def test_every_verdict_is_a_sentence_and_what_is_missing_is_left_out(verdict):
    page = html_of({"verdict": verdict, "reason": "because of this"})
    text = said(page)
    assert verdict in text
    assert "None" not in text
    assert "null" not in text
    assert text.count("because of this".capitalize()) == 1


@pytest.mark.parametrize("key", DATA)
def test_any_part_may_be_missing_or_null(key):
    for data in ({name: value for name, value in DATA.items() if name != key}, DATA | {key: None}):
        assert "None" not in said(html_of(data))


def test_an_ambiguous_set_is_listed_with_the_motion_that_would_separate_it():
    data = DATA | {
        "verdict": "ambiguous",
        "findings": [],
        "cannot_be_told_apart": ["wheel_radius 2 1", "tick_loss 2 1"],
        "separating_motion": "figure eight",
    }
    text = said(html_of(data))
    assert "wheel radius 2 1" in text
    assert "tick loss 2 1" in text
    assert "A motion that would: figure eight ." in text
