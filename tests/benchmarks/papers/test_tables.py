"""Vogt's tables beside ours: recomputed with complex numbers, and compared with the lines of the paper's text."""

import cmath
import json
import math
import re

import matplotlib.image
import pytest

from benchmarks.papers import select_tables
from benchmarks.papers.comparison import Comparison, Effort
from benchmarks.tasks.static_tests import STATIC_TESTS

METRICS = ("theta_xy", "theta_phi", "theta_dev")

#: Table 1 as the text of the paper has it, line by line: error, then (second line) CON1 and CON2, for each metric.
TABLE_1 = """
    axle 1 0.357 68.4 23.0
    axle 2 0.138 0.622 0.022 34.6 0.498 0.008 11.3 0.519 0.024
    axle 3 0.135 34.3 11.1
    axle 1 0.758 151.9 52.3
    axle 2 0.277 0.635 0.491 91.2 0.400 0.250 8.5 0.838 0.782
    axle 3 0.544 121.5 38.8
    axle 1 0.305 60.8 15.7
    axle 2 0.300 0.511 0.016 101.5 0.401 0.248 25.0 0.561 0.374
    axle 3 0.613 80.8 35.7
    axle 1 0.608 120.8 41.8
    axle 2 0.225 0.630 0.013 60.6 0.499 0.005 18.4 0.559 0.015
    axle 3 0.228 60.8 18.7
"""
TABLE_2 = """
    0 P 0 P 0 P
    0 P 0 P 0 P
    0 P 0.065 F 0.065 F
    0 P 0 P 0 P
"""


def printed_values():
    """Return what Table 1 prints, as text, by (test, metric, axle or measure)."""
    found = {}
    for k, line in enumerate(TABLE_1.strip().splitlines()):
        numbers = line.split()[2:]
        test, axle = divmod(k, 3)
        step = len(numbers) // 3
        for m, metric in enumerate(METRICS):
            names = (axle + 1, "CON1", "CON2")[:step]
            found |= {
                (test + 1, metric, name): text
                for name, text in zip(names, numbers[m * step : (m + 1) * step], strict=True)
            }
    return found


def attached(test, axle):
    """Return (position, heading) of the axles, the relative poses attached to `axle` (from 0)."""
    od = [(complex(x, y), psi) for x, y, psi in test.odometry]
    poses = {axle: od[axle]}
    for i in range(axle, 0, -1):  # forward
        (place, psi), (x, y, phi) = poses[i], test.relative[i - 1]
        poses[i - 1] = (place + cmath.rect(1, psi) * complex(x, y), psi + phi)
    for i in range(axle, 2):  # backward
        (place, psi), (x, y, phi) = poses[i], test.relative[i]
        poses[i + 1] = (place - cmath.rect(1, psi - phi) * complex(x, y), psi - phi)
    return [poses[i] for i in range(3)]


def thetas(test):
    """Return the three errors of each metric, in the paper's units."""
    od = [(complex(x, y), psi) for x, y, psi in test.odometry]
    found = {metric: [] for metric in METRICS}
    for axle in range(3):
        poses = attached(test, axle)
        found["theta_xy"].append(sum(abs(p - q) for (p, _), (q, _) in zip(od, poses, strict=True)))
        found["theta_phi"].append(math.degrees(sum(abs(a - b) for (_, a), (_, b) in zip(od, poses, strict=True))))
        turn = (od[0][0] - od[2][0]) / (poses[0][0] - poses[2][0])
        found["theta_dev"].append(math.degrees(abs(cmath.phase(turn))))
    return found


def all_values(name):
    (source,) = select_tables([name])
    table = source.compute(Effort())
    return {
        (*(value for _, value in comparison.place), comparison.quantity): comparison for comparison in table.comparisons
    }


def test_odometry_is_that_of_the_captions_front_first():
    for test in STATIC_TESTS:
        assert list(test.odometry[:, 0]) == [0.7 if test.number == 4 else 0.8, 0.45, 0.1]
        assert list(test.odometry[:, 1]) == [0.3 if test.number == 4 else 0.1, 0.1, 0.1]
        assert list(test.odometry[:, 2]) == [math.pi / 3 if test.number == 4 else 0, 0, 0]
    bends = [[math.copysign(1, phi) for phi in test.relative[:, 2]] for test in STATIC_TESTS[1:3]]
    assert bends == [[1, 1], [1, -1]]


@pytest.mark.parametrize("test", STATIC_TESTS, ids=lambda test: f"test {test.number}")
def test_the_truth_agrees_with_odometry_at_the_true_axle_and_with_the_frames_everywhere(test):
    expected = attached(test, test.true_axle - 1)
    for (place, heading), (x, y, psi) in zip(expected, test.truth, strict=True):
        assert abs(complex(x, y) - place) < 1e-14
        assert psi == pytest.approx(heading, abs=1e-14)


def test_all_60_values_of_table_1_agree_with_the_paper_and_with_complex_numbers():
    computed = all_values("vogt-1")
    printed = printed_values()
    assert len(printed) == 60
    for (test, metric, name), text in printed.items():
        comparison = computed[test, metric, name, "error" if isinstance(name, int) else "confidence value"]
        assert comparison.printed == float(text)
        assert comparison.digits == len(text.partition(".")[2])
        errors = thetas(STATIC_TESTS[test - 1])[metric]
        low, middle, high = sorted(errors)
        confidence = {"CON1": (high - low) / high, "CON2": (middle - low) / middle}
        expected = errors[name - 1] if isinstance(name, int) else confidence[name]
        assert comparison.ours == pytest.approx(expected, abs=1e-11)
        assert abs(expected - float(text)) <= 0.5 * 10**-comparison.digits
        assert comparison.agrees
    assert sum(comparison.quantity in ("error", "confidence value") for comparison in computed.values()) == 60


def test_the_selected_axle_is_that_of_the_lowest_error_in_print_and_here():
    computed = all_values("vogt-1")
    printed = printed_values()
    for test in STATIC_TESTS:
        for metric in METRICS:
            selection = computed[test.number, metric, "selection"]
            assert selection.printed == min((1, 2, 3), key=lambda axle: float(printed[test.number, metric, axle]))
            errors = thetas(test)[metric]
            assert selection.ours == 1 + errors.index(min(errors))


def test_table_2_is_the_mean_distance_from_the_truth():
    computed = all_values("vogt-2")
    for test, line in zip(STATIC_TESTS, TABLE_2.strip().splitlines(), strict=True):
        truth = attached(test, test.true_axle - 1)
        cells = line.split()
        for metric, error, verdict in zip(METRICS, cells[::2], cells[1::2], strict=True):
            errors = thetas(test)[metric]
            chosen = attached(test, errors.index(min(errors)))
            mean = sum(abs(p - q) for (p, _), (q, _) in zip(truth, chosen, strict=True)) / 3
            value, passed = computed[test.number, metric, "position error"], computed[test.number, metric, "verdict"]
            assert (value.printed, passed.printed) == (float(error), verdict)
            assert value.ours == pytest.approx(mean, abs=1e-14)
            assert passed.agrees
            assert value.agrees == (verdict == "P")


def test_a_value_agrees_up_to_half_a_last_digit():
    def agrees(computed):
        return Comparison((), "", "", "error", "m", 0.135, computed, 3).agrees

    assert agrees(0.1345)
    assert agrees(0.1355)
    assert not agrees(0.13449)
    assert not agrees(0.13551)
    assert not Comparison((), "", "", "verdict", None, "P", "F").agrees


def test_people_read_printed_beside_ours_and_how_many_agree(castor_bench):
    code, out, err = castor_bench("tables", "--sets", 2)
    assert (code, err) == (0, "")
    assert "36 of 36 errors, 12 of 12 selections and 24 of 24 confidence values agree to the printed rounding" in out
    assert "10 of 12 position errors and 12 of 12 verdicts agree" in out
    for text in printed_values().values():
        assert re.search(rf"(?<![\d.]){re.escape(text)} \| [\d.]+ =", out), text
    assert out.count("0.065 | 0.1963 !=") == 2
    assert out.count("The printed 0.065 m is not explained: mean 0.1963, largest 0.3429, rms 0.2220 m") == 2


def test_json_is_complete_and_has_its_format_and_units(castor_bench):
    code, out, err = castor_bench("tables", "--json", "--sets", 2)
    assert (code, err) == (0, "")
    data = json.loads(out)
    assert data["format"] == "castor-tables/1"
    tables = {table["name"]: table for table in data["tables"]}
    assert tables["vogt-1"]["agreement"]["error"] == {"agree": 36, "of": 36}
    assert tables["vogt-1"]["agreement"]["confidence value"] == {"agree": 24, "of": 24}
    values = tables["vogt-1"]["values"]
    (entry,) = (v for v in values if (v["test"], v["metric"], v.get("axle")) == (3, "theta_dev", 2))
    assert entry["printed_deg"] == 25.0
    assert entry["agrees"] is True
    differing = [v for v in tables["vogt-2"]["values"] if not v["agrees"]]
    assert [(v["test"], v["metric"], v["printed_m"]) for v in differing] == [
        (3, "theta_phi", 0.065),
        (3, "theta_dev", 0.065),
    ]
    assert [sweep["name"] for sweep in data["failure_modes"]["sweeps"]] == ["same-side", "opposite-sides"]


def test_pictures_are_written_and_show_something(castor_bench, tmp_path):
    folder = tmp_path / "new" / "pictures"
    code, out, _ = castor_bench("tables", "--table", "vogt-1", "--json", "--figures", folder)
    assert code == 0
    assert json.loads(out)
    names = {"failure-modes.png", *(f"configuration-test-{k}.png" for k in (1, 2, 3, 4))}
    assert {path.name for path in folder.iterdir()} == names
    for path in folder.iterdir():
        assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
        pixels = matplotlib.image.imread(path)[..., :3]
        assert min(pixels.shape[:2]) > 500
        # Lines of at least four colours beside grey and white.
        solid = (255 * pixels).round().astype(int).reshape(-1, 3)
        coloured = solid[(solid.max(axis=1) - solid.min(axis=1)) > 60]
        assert len(coloured) > 1000


def test_a_file_in_the_folders_place_is_one_clear_line(castor_bench, tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        code, out, err = castor_bench("tables", "--table", "vogt-1", "--figures", folder)
        assert (code, out) == (2, "")
        assert err.startswith(f"error: --figures {folder}: a file is in the folder's place")
        assert err.count("\n") == 1
