"""The page and the words of a diagnosis by posterior, from data alone."""

from html.parser import HTMLParser
from typing import Any

import pytest

from discrepancy.report import sentences
from discrepancy.report.answers import drawn, html_of
from discrepancy.report.parts import names_apart
from discrepancy.report.pictures import Picture, probabilities

RADIUS, LATE = "wheel radius, castor 2, wheel 1", "latency of one encoder, castor 3"
ANSWER = {
    "verdict": "named",
    "reason": RADIUS,
    "what": RADIUS,
    "probability": 0.97,
    "probabilities": {"wheel_radius 2 1": 0.97, "encoder_latency 3 None": 0.03},
    "credible_set": ["wheel_radius 2 1"],
    "effect": {"name": "wheel_radius", "castor": 2, "wheel": 1, "value": 0.00498},
    "size": 0.00498,
    "unit": "1",
    "interval": [0.00465, 0.00531],
    "cost": [0.0392, 0.0],
    "check": "Measure the wheel's diameter under load.",
    "same_as": [],
    "curve": None,
    "separating_drive": None,
}
SUMMARY = {
    "drive": "commands",
    "notes": [],
    "window_s": 5.0,
    "windows": 12,
    "driven_m": 8.1,
    "position_rms_mm": 8.24,
    "heading_rms_mrad": 8.26,
    "wheels_rms_mm": 1.63,
    "pivots_rms_mrad": None,
}
AFTER = SUMMARY | {"position_rms_mm": 2.06}
DATA: dict[str, Any] = {
    "format": "castor-diagnosis/2",
    "robot": "base",
    "verdict": "named",
    "mistakes": [],
    "answers": [ANSWER],
    "dimensions": [],
    "probabilities": {"wheel_radius 2 1": 0.97, "encoder_latency 3 None": 0.03},
    "names": {"wheel_radius 2 1": RADIUS, "encoder_latency 3 None": LATE},
    "gap": [[0.0125, 0.0123], [0.0004, 0.0005]],
    "held_out_gap": None,
    "clean_gap": None,
    "noise": {"position_m": 0.0003, "heading_rad": 0.0002, "poses": 1000},
    "logs": ["monday/log.csv", "tuesday/log.csv"],
    "held_out_logs": [],
    "clean_logs": [],
    "preflight": [],
    "effects": [ANSWER["effect"]],
    "robot_file": "out/robot.json",
    "replay": {"before": SUMMARY, "after": AFTER, "held_out_before": None, "held_out_after": None},
    "where": None,
}
UNCONFIRMED = ANSWER | {"verdict": "unconfirmed", "reason": f"the held-out logs do not confirm {RADIUS}"}
UNEXPLAINED = ANSWER | {
    "verdict": "unexplained",
    "what": "wheel_1l jumps at 3.0 s",
    "reason": "no effect of the catalogue explains it; it looks like: wheel_1l jumps at 3.0 s",
    "effect": None,
    "unit": None,
    "check": "",
}
AMBIGUOUS = ANSWER | {"verdict": "ambiguous", "probability": 0.6, "credible_set": ["wheel_radius 2 1", LATE]}
AMBIGUOUS["probabilities"] = {"wheel_radius 2 1": 0.6, "encoder_latency 3 None": 0.4}
CURVE = {
    "of": "castor angle",
    "unit": "rad",
    "knots": [0.0, 1.5, 3.0, 4.5],
    "values": [0.0, 0.0102, 0.0, -0.0095],
    "low": [-0.001, 0.0052, -0.001, -0.0115],
    "high": [0.001, 0.0152, 0.001, -0.0075],
    "nearest": {"what": "slope of the floor", "cosine": 0.187},
}
LEARNED = UNEXPLAINED | {"what": "a term learned from logs", "size": 1.0, "unit": "1", "curve": CURVE}
TRIFLE = ANSWER | {"verdict": "negligible", "cost": [1e-4, 0.0], "reason": f"{RADIUS} costs less than matters"}


class Reader(HTMLParser):
    """Reads a page, and fails where a tag is not closed or a section or card is empty."""

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.said, self.filled = [], set(), [], []
        self.feed(page)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag not in ("meta", "br", "img"):
            self.open.append(tag)
            self.filled.append(0)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        filled = self.filled.pop()
        assert filled or tag not in ("section", "article", "ul", "dl", "dd", "table", "p")
        if self.filled:
            self.filled[-1] += filled

    def handle_data(self, data):
        if self.open and data.strip() and "style" not in self.open:
            heading = self.open[-1] in ("h2", "h3", "dt", "summary")
            self.filled[-1] += not heading
            self.said.append(data.strip())


def said(data, pictures=()):
    return " ".join(" ".join(Reader(html_of(data, pictures)).said).partition("All that this page was made")[0].split())


def answered(*answers, **more):
    return DATA | {"answers": list(answers), "verdict": answers[0]["verdict"] if answers else "no discrepancy"} | more


def test_the_page_says_what_is_missing_how_sure_what_it_costs_and_what_to_check():
    text = said(DATA)
    told = f"The robot's file lacks {RADIUS} (+0.498 %, 97 % sure), which costs 39.2 mm after 10 m."
    assert told in text
    assert told == sentences.sentence(DATA)
    for part in (f"or else {LATE} (3 %)", "+0.498 % (+0.465 to +0.531)", ANSWER["check"], "position mm 12.50 0.40 3 %"):
        assert part in text
    assert "after a turn" not in text


def test_effects_that_are_the_same_on_the_robot_are_listed():
    every = "radius of all wheels"
    same = ANSWER | {"same_as": ["all_wheel_radius"]}
    data = answered(same, names=DATA["names"] | {"all_wheel_radius": every})
    assert f"  the same on this robot, whatever it does: {every}" in sentences.as_lines(data)
    assert f"the same here {every}" in said(data)


@pytest.mark.parametrize(
    ("more", "first"),
    [
        ({"gap": [[0.0125, 0.01], [0.01, 0.001]]}, "80 % of the gap stays unexplained: 10 of 12.5 mm (rms)."),
        (
            {"gap": [[0.01, 0.01], [0.0125, 0.01]]},
            "What is named does not shrink the gap: 12.5 instead of 10 mm (rms).",
        ),
        ({"held_out_gap": [[0.01, 0.01], [0.006, 0.01]]}, "60 % of the gap on the held-out logs stays unexplained"),
        ({"gap": None}, "What is named does not shrink the gap between simulated and measured wheel counts"),
    ],
)
def test_it_says_first_that_half_of_the_gap_or_more_stays(more, first):
    data = DATA | more
    assert sentences.sentence(data).startswith(first)
    assert sentences.as_lines(data)[0].startswith(first)
    assert sentences.unexplained(data)
    assert not sentences.stays(DATA)


def test_where_half_of_the_gap_stays_it_names_the_likeliest_of_what_is_left_out():
    stays = DATA | {"gap": [[0.0125, 0.01], [0.01, 0.001]]}
    says = "The likeliest of what is left out: latency of one encoder, castor 3 (3 %)."
    assert says in sentences.sentence(stays)
    assert says in sentences.as_lines(stays)
    assert not sentences.left_out(DATA)


def test_of_a_gap_that_is_noise_it_says_so():
    data = DATA | {
        "gap": [[0.0013, 0.001], [0.0011, 0.001]],
        "noise": {"position_m": 0.0008, "heading_rad": 0.001, "poses": 1000},
    }
    says = "85 % of the gap stays, 1.1 of 1.3 mm (rms); the reference's own noise is about 1.1 mm."
    assert sentences.sentence(data).startswith(says)
    assert not sentences.unexplained(data)


def test_of_a_gap_that_clean_logs_have_as_well_it_says_so():
    data = DATA | {"gap": [[0.0051, 0.005], [0.00365, 0.003]], "clean_gap": [0.009, 0.006], "clean_logs": ["good.csv"]}
    says = "72 % of the gap stays, 3.65 of 5.1 mm (rms); it is 9 mm in the clean logs."
    assert sentences.sentence(data).startswith(says)
    assert not sentences.unexplained(data)
    assert sentences.gaps_of(data)[-1].endswith("is off the reference in the clean logs by 9 mm and 6 mrad (rms)")
    assert "In the clean logs it is 9 mm and 6 mrad." in html_of(data, [])


def test_a_gross_mistake_is_reported_with_its_alternatives():
    mistake = {"verdict": "ambiguous", "what": "pivot_1 is reversed: see", "alternatives": ["wheel_1l is reversed"]}
    text = sentences.sentence(answered(mistakes=[mistake]))
    assert text.startswith("Gross mistake: pivot_1 is reversed, or else wheel_1l is reversed.")
    lines = sentences.as_lines(answered(mistakes=[mistake], preflight=[mistake["what"], "short"]))
    assert lines[1:4] == ["pre-flight: pivot_1 is reversed: see", "  or: wheel_1l is reversed", "pre-flight: short"]


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (answered(UNCONFIRMED), "The held-out logs do not confirm what seems to be missing: wheel radius"),
        (answered(UNEXPLAINED), "it looks like wheel_1l jumps at 3.0 s (97 % sure)"),
        (
            answered(AMBIGUOUS),
            f"these motions cannot distinguish: {RADIUS} (60 %) or {LATE} (40 %), which costs 39.2 mm",
        ),
        (answered(TRIFLE), f"for wheels that slip. Negligible: {RADIUS} costs less than matters."),
        (answered(TRIFLE, noise=None), f"Nothing that matters is missing: {RADIUS} costs less than matters."),
        (answered(), "No effect that matters is found, but odometry is off the reference by 12.5 mm"),
        (answered(noise=None), "The robot's file explains these logs: nothing is missing."),
        (
            answered(noise={"position_m": 0.02, "heading_rad": 0.02, "poses": 1000}),
            "explains these logs, beside the reference's own noise of about 28.3 mm and 20 mrad: nothing is missing.",
        ),
        (  # one pose tells little of noise, a hundred do
            answered(noise={"position_m": 0.0006, "heading_rad": 0.001, "poses": 1}),
            "explains these logs, beside the reference's own noise of about 0.849 mm",
        ),
        (
            answered(noise={"position_m": 0.0006, "heading_rad": 0.001, "poses": 100}),
            "No effect that matters is found, but odometry is off the reference by 12.5 mm",
        ),
        (
            answered(noise={"position_m": 0.02, "heading_rad": 4.2, "poses": 1000}, too_little=True),
            "Nothing is found, but these logs show too little to be sure, beside the reference's own noise of about "
            "28.3 mm and 4200 mrad: drive on for longer.",
        ),
    ],
)
def test_every_verdict_is_a_sentence_and_lines_and_a_page_without_empty_parts(data, part):
    data = data | {"gap": [DATA["gap"][0], None], "effects": [], "robot_file": None}
    data["replay"] = DATA["replay"] | {"after": None}
    text = said(data)
    assert part in text
    for words in (text, "\n".join(sentences.as_lines(data))):
        assert data["verdict"] in words
        assert "None" not in words
        assert "nan" not in words
    assert "after" not in text.partition("Odometry with predicted creep less reference")[2].partition("mm")[0]
    assert len(sentences.as_lines(data)) <= 10


def test_an_ambiguous_answer_tells_the_drive_that_would_separate_it():
    proposed = {"drive": "squares with reference poses", "expected_log_bayes_factor": 12.34, "duration_s": 65.4}
    data = answered(AMBIGUOUS | {"separating_drive": proposed})
    told = "squares with reference poses (65.4 s; expected log Bayes factor 12.3)"
    assert f"a drive that would distinguish them {told}" in said(data)
    assert f"  to distinguish them, drive {told}" in "\n".join(sentences.as_lines(data))
    assert "a drive that would distinguish them" not in said(answered(AMBIGUOUS))
    assert "no drive" in sentences.why_no_drive(answered(AMBIGUOUS))
    assert sentences.why_no_drive(answered(ANSWER)) == "nothing is ambiguous"


def test_a_learned_curve_is_drawn_and_compared_with_the_catalogue():
    data = answered(LEARNED)
    (picture,) = (picture for picture in drawn(data) if picture.name == "curve")
    assert "-0.95 % at 258 degrees up to +1.02 % at 85.9 degrees" in picture.alt
    text = said(data, [picture])
    for part in (
        "reads too much by \N{MINUS SIGN}0.95 to +1.02 %",
        "nearest in the catalogue slope of the floor, by what it does to these logs (cosine 0.19; 1: the same)",
        "against the angle of the castor",
    ):
        assert part in text
    assert "+100" not in text
    assert "looks like a term learned from logs (\N{MINUS SIGN}0.95 to +1.02 %, 97 % sure)" in sentences.sentence(data)
    assert not [picture for picture in drawn(DATA) if picture.name == "curve"]


def test_of_many_answers_the_sentence_tells_the_costliest():
    dear = UNEXPLAINED | {"what": "the dearest", "cost": [1.0, None]}
    text = sentences.sentence(answered(UNEXPLAINED, ANSWER, dear, UNEXPLAINED, UNEXPLAINED))
    assert "it looks like the dearest" in text
    assert "; and 3 more." in text


@pytest.mark.parametrize("key", ["gap", "held_out_gap", "clean_gap", "noise", "replay", "where", "robot_file"])
def test_what_is_not_known_is_left_out(key):
    assert "None" not in said(DATA | {key: None}).replace("encoder_latency 3 None", "")


def test_nothing_from_a_file_is_taken_for_markup():
    evil = "<script>alert(1)</script>\"'&"

    def poisoned(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: poisoned(item) for key, item in value.items()}
        if isinstance(value, list):
            return [poisoned(item) for item in value]
        return evil if isinstance(value, str) and value != "commands" else value

    for answer in (ANSWER, UNEXPLAINED, AMBIGUOUS, TRIFLE):
        data = poisoned(answered(answer, mistakes=[{"what": "x", "alternatives": []}], preflight=["x"])) | {
            "answers": [poisoned(answer)]
        }
        data["answers"][0]["verdict"] = answer["verdict"]
        page = html_of(data, [Picture("drift", "<svg></svg>", evil, evil)])
        assert "script" not in Reader(page).tags
        assert "&lt;script&gt;" in page


def test_slip_is_where_there_is_some():
    where = {"log": "a", "channel": "wheel 2l rolling", "share_of_slip": 0.66, "most_slip_m": 0.002, "at_s": 52.5}
    assert "Where slip is left" not in said(DATA)
    assert "wheel 2l rolling (66 %)" in said(DATA | {"where": where | {"x_m": 1.76, "y_m": 0.34}})


def test_logs_are_called_by_as_much_as_tells_them_apart():
    assert list(names_apart(["a/log.csv", "b/log.csv", "c/d.csv"]).values()) == ["a/log.csv", "b/log.csv", "d.csv"]
    assert list(names_apart(["x/a/log.csv", "y/a/log.csv", "log.csv"]).values()) == [
        "x/a/log.csv",
        "y/a/log.csv",
        "log.csv",
    ]
    assert "log 1: monday/log.csv, log 2: tuesday/log.csv" in said(DATA)


def test_probabilities_are_drawn_the_likeliest_first():
    picture = probabilities([("a", 0.1, "10 %"), ("b <$x$>", 0.9, "90 %")], ["a"])
    assert "b <$x$> 90 %, a 10 %" in picture.alt
    assert "&lt;$x$&gt;" in html_of(DATA, [picture])
