"""What pages are made of: safe names, inert data, a policy that names the scripts, maps and curves true to scale."""

import hashlib
import json
import re
from base64 import b64encode
from html import unescape

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.floor import Cable, Floor, Patch
from castor_envs.rendering.pages.curves import MOST, Chart, Curve
from castor_envs.rendering.pages.maps import Line, Spot, floor_map
from castor_envs.rendering.pages.page import as_data, render, safe_name


@given(st.text(max_size=300))
def test_any_name_makes_a_file_that_every_system_takes(name):
    safe = safe_name(name)
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,75}", safe, re.ASCII)
    assert not safe.endswith(".")


def test_different_names_have_different_files_whatever_a_system_takes_for_the_same():
    names = ["cast-0", "CAST-0", "cast_0", "cast/0", "cast?0", "a" * 60, "a" * 61, "a" * 62, "", ".", "..", "ä", "ö"]
    assert len({safe_name(name).casefold() for name in names}) == len(names)
    assert [safe_name(name) for name in ("cast-0", "umbmark-physics-clean")] == ["cast-0", "umbmark-physics-clean"]


@given(st.recursive(st.text() | st.floats() | st.none(), lambda of: st.lists(of) | st.dictionaries(st.text(), of)))
def test_data_in_a_page_is_inert_and_comes_back(data):
    text = as_data(data)
    assert not set(text) & set("<>&")

    def plain(value):
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    assert json.loads(text) == plain(data)


def test_the_policy_has_the_digest_of_every_script_and_no_other(tmp_path):
    (tmp_path / "own.html").write_text('{% extends "base.html" %}{% block main %}{{ name }}{% endblock %}')
    page = render(tmp_path, "own.html", name="<script>alert(1)</script>")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)
    bodies = re.findall(r"<script>(.*?)</script>", page, flags=re.S)
    digests = {b64encode(hashlib.sha256(body.encode()).digest()).decode() for body in bodies}
    assert set(re.findall(r"'sha256-([^']+)'", unescape(policy))) == digests
    assert len(digests) == 3
    assert "default-src 'none';" in unescape(policy)
    linked = render(tmp_path, "own.html", "assets", name="")
    assert "<script>" not in linked
    assert "script-src 'self';" in unescape(linked)


def test_a_map_is_true_to_scale_with_y_up():
    floor = Floor(
        patches=(Patch(center=(1.0, 0.5), size=(0.4, 0.2), friction=0.1),),
        cables=(Cable(center=(0.5, 0.0), direction=0.0, length=0.5, diameter=0.01),),
    )
    line = Line(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]), "true", "")
    of = floor_map([line], "", [Spot(2.0, 1.0, 3.0, "slip", "")], floor, friction=0.9)
    (x0, y0), (x1, y1), (x2, y2) = (map(float, place.split(",")) for place in of.paths[0].points.split())
    scale = (x1 - x0) / 2.0
    assert abs(y0 - y1) < 0.11
    assert abs((y1 - y2) - scale) < 0.3  # places are rounded to a tenth
    assert abs(x1 - x2) < 0.11
    assert (of.spots[0].x, of.spots[0].y) == (x2, y2)
    corners = np.array([[float(n) for n in place.split(",")] for place in of.patches[0].points.split()])
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.4 * scale, 0.2 * scale], atol=0.3)
    assert of.patches[0].kind == "slippery"
    assert abs(of.cables[0][2] - of.cables[0][0] - 0.5 * scale) < 0.3
    step = float(of.scale.split()[1])
    upright = sorted(line[0] for line in of.gridlines if line[0] == line[2])
    np.testing.assert_allclose(np.diff(upright), step * scale, atol=0.3)
    assert all(0 <= place <= of.width for place in upright)


def test_nothing_to_see_makes_a_map_too():
    of = floor_map([Line(np.full((3, 2), np.nan), "true", "")], "")
    assert of.paths[0].points == ""
    assert of.height > 0


def test_lines_and_curves_end_at_gaps():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [np.nan, np.nan], [3.0, 0.0], [4.0, 0.0]])
    of = floor_map([Line(points, "true", "path")], "")
    assert [len(path.points.split()) for path in of.paths] == [2, 2]
    drawn = Chart("x", "y", (Curve("c", np.arange(5.0), points[:, 0], 1),), "", "").curves["series"][0]
    assert drawn["y"] == [0.0, 1.0, None, 3.0, 4.0]


def test_a_long_curve_keeps_its_peaks():
    x = np.linspace(0, 10, 50_000)
    y = np.sin(x)
    y[31_234], y[77] = 5.0, np.nan
    drawn = Chart("x", "y", (Curve("c", x, y, 1),), "", "").curves["series"][0]
    assert len(drawn["x"]) == len(drawn["y"]) <= MOST + 1  # with a gap
    assert max(value for value in drawn["y"] if value is not None) == 5.0
    assert drawn["x"] == sorted(drawn["x"])
