"""Maps and curves of a drive."""

from collections.abc import Sequence

import numpy as np

from benchmarks.show.drives import Drive
from benchmarks.show.slip import Place, Slips
from castor_envs.geometry.arrays import Array
from castor_envs.rendering.pages.curves import ZOOM, Chart, Curve, color_of
from castor_envs.rendering.pages.maps import FloorMap, Line, Spot, floor_map
from castor_envs.vehicles.train import TrainDescription

LARGEST_SPOT, SMALLEST_SPOT = 16.0, 4.0
"""Radii of spots where contacts slipped, in units of a map."""

LEAST_SLIP = 1e-6
"""m, that a chart shows; where no encoder can disagree, rounding errors of the computer are below it."""

DISAGREEMENT = (
    "How far encoders disagree: the part of what each castor's wheels report in half a second that no motion of the "
    "body explains. It needs no reference. Where one castor stands out, it slipped, or its numbers in the file are "
    "wrong."
)
SLIP = (
    "Slip against the reference: by how much wheels rolled, or moved sideways, in half a second other than the body's "
    "true motion says. Errors of the robot's file show in it too."
)


def path_map(drive: Drive, names: Sequence[str], places: Sequence[Place] = ()) -> FloorMap:
    """Return the true and all estimated paths on the floor; of a train those of its front axle, the rear one faint.

    Of a single pose of a train, its axles, joined from the front to the rear.
    names: of all estimators of the page, by whose order they have their colours. places: where contacts slipped.
    """
    lines, spots = [], []
    if len(drive.samples) == 1 and drive.start.ndim > 1:
        lines.append(Line(drive.truth[:, 0], "true", "true places of the axles, joined"))
    elif drive.dense:
        if drive.start.ndim > 1:
            lines.append(Line(drive.path(len(drive.start) - 1), "true rear", "true path of the last axle"))
        lines.append(Line(drive.path(), "true", "true path"))
    else:
        known = front(drive.truth)[drive.known, :2].tolist()
        spots += [Spot(x, y, 4.0, "start", "reference pose") for x, y in known]
    for name, poses in drive.estimates.items():
        path = poses[:, 0] if len(drive.samples) == 1 and poses.ndim > 2 else front(poses)
        lines.append(Line(path, f"estimate s{color_of(names.index(name))}", name))
    x, y = np.atleast_2d(drive.start)[0, :2].tolist()
    spots.append(Spot(x, y, 6.0, "start", "start"))
    largest = max((place.slip for place in places), default=1.0)
    for place in places:
        size = max(LARGEST_SPOT * float(np.sqrt(place.slip / largest)), SMALLEST_SPOT)
        said = f"{place.part}: {1e3 * place.slip:.2g} mm at {place.t:.1f} s"
        spots.append(Spot(place.x, place.y, size, "slip", said))
    of_train = isinstance(drive.vehicle, TrainDescription)
    robot = drive.vehicle.modules[0] if isinstance(drive.vehicle, TrainDescription) else drive.vehicle
    whose = "the front axle" if of_train else "the robot"
    alt = f"Map of the floor: the true path of {whose} and the paths that {len(drive.estimates)} estimators give"
    return floor_map(lines, alt, spots, drive.floor, robot.contact.friction)


def error_charts(drive: Drive, names: Sequence[str]) -> list[Chart]:
    """Return position and heading errors against the distance driven; none without a path, nor of headings that are
    not known."""
    if drive.known.sum() < 2 or not drive.estimates:
        return []
    of = {name: drive.errors(name) for name in drive.estimates}
    ends = "; ".join(f"{name} ends {1e3 * of[name][0][drive.known][-1]:.3g} mm off" for name in of)
    mean = " (mean of the axles)" if drive.start.ndim > 1 else ""

    def chart(k: int, label: str, unit: str, factor: float, further: str, caption: str) -> Chart:
        curves = [Curve(name, *drive.against_way(factor * of[name][k]), color_of(names.index(name))) for name in of]
        alt = f"{label} against the distance driven{further}"
        return Chart("driven, m", f"{label}, {unit}", tuple(curves), alt, f"{label.capitalize()}{mean}{caption}")

    charts = [chart(0, "position error", "mm", 1e3, f"; {ends}", f" against the distance driven. {ZOOM}")]
    if drive.headed.any():
        charts.append(chart(1, "heading error", "°", 180 / np.pi, "", "."))
    return charts


def slip_charts(slips: Slips) -> list[Chart]:
    """Return disagreement and slip by castor or axle against the distance driven; what is nowhere, or below what
    numbers can tell, is left out."""
    charts = []
    for name, values, caption in (
        ("disagreement", slips.disagreement, DISAGREEMENT),
        ("slip", slips.slip, SLIP),
    ):
        if values is None or not float(np.nanmax(values, initial=0.0)) > LEAST_SLIP:
            continue
        curves = tuple(
            Curve(part, slips.way, 1e3 * values[:, i], color_of(i + 4)) for i, part in enumerate(slips.parts)
        )
        k, i = np.unravel_index(int(np.nanargmax(values)), values.shape)
        most = f"{1e3 * values[k, i]:.2g} mm, at {slips.parts[i]}, {slips.t[k]:.1f} s"
        alt = f"{name} against the distance driven; most, {most}"
        charts.append(Chart("driven, m", f"{name}, mm", curves, alt, caption))
    return charts


def front(poses: Array) -> Array:
    """Return poses (M, 3) as they are, of a train's axles (N, M, 3) those of the front one."""
    return poses if poses.ndim == 2 else poses[0]
