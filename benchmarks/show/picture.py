"""A drive as a picture or as one that moves: the vehicle, its true path and one estimate, on the floor.

Where nobody knows the true path, or its headings, the vehicle is drawn where the estimate has it.
"""

import contextlib
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.show.drives import Drive
from castor_envs.errors import InputError
from castor_envs.files import write_atomically, writing
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.rendering import Renderer
from castor_envs.rendering.train_figure import frame_curve
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

SIZE = 640
"""Pixels each way."""
FRAMES, PERIOD = 100, 80
"""How many pictures there are at most in one that moves, and ms of each, in which GIF has whole hundredths of a second.
It takes eight seconds, however long the drive was, and less where fewer poses are known."""
MARK = b"castor-envs show"
"""Stands near the beginning of every picture of this command."""
MARGIN = 0.25
"""m, seen around all paths."""


def write_png(path: Path, drive: Drive, name: str | None) -> None:
    """Write the end of a drive as PNG, with all of its true path and that of the estimate called `name`, if any.

    Raises InputError for a drive with neither a reference nor an estimate.
    """
    _save(path, "PNG", _pictures(drive, name, 1))


def write_gif(path: Path, drive: Drive, name: str | None) -> None:
    """Write a whole drive as a GIF that plays in eight seconds and begins again; raises as `write_png`."""
    _save(path, "GIF", _pictures(drive, name, FRAMES))


def check_picture(option: str, path: Path) -> None:
    """Raise InputError where a file is there already that is no picture of this command."""
    if path.exists():
        ours = False
        with contextlib.suppress(OSError):
            ours = MARK in path.read_bytes()[:2000]
        if not ours:
            raise InputError(f"{option} {path}: is there already, and no picture of this command; name another file")


def _pictures(drive: Drive, name: str | None, frames: int) -> list[NDArray[np.uint8]]:
    """Return at most so many pictures of a drive, the end with them; each holds the paths until then."""
    known = bool(drive.headed.any())
    if not known:
        if name is None:
            problem = "there is neither a reference nor an estimate to draw the vehicle at; name an --estimator"
            raise InputError(f"{drive.name}: {problem}")
        drive, name = _believed(drive, name), None
    rows = np.flatnonzero(drive.headed)
    shown = set(rows[np.unique(np.linspace(len(rows) - 1, 0, frames).astype(np.intp))].tolist())
    estimate = None if name is None else drive.estimates[name]
    renderer = Renderer(
        drive.vehicle,
        drive.floor or Floor(),
        "rgb_array",
        1000 // PERIOD,
        (SIZE, SIZE),
        _arena(drive, rows, estimate),
        known,
    )
    pictures = []
    for k in rows.tolist():
        pose, believed = drive.truth[..., k, :], None if estimate is None else estimate[..., k, :]
        if k in shown:
            time = float(drive.log.t[drive.samples[k]] - drive.log.t[0])
            pictures.append(renderer.draw(pose, _shape(drive, k), estimate=believed, time=time))
        else:
            renderer.lengthen(pose, believed)
    return [picture for picture in pictures if picture is not None]


def _believed(drive: Drive, name: str) -> Drive:
    """Return the drive with an estimate as its reference."""
    believed = drive.estimates[name]
    rows = believed if believed.ndim == 2 else believed.swapaxes(0, 1).reshape(len(drive.samples), -1)
    reference = np.full((len(drive.log), rows.shape[1]), np.nan)
    reference[drive.samples] = rows
    return replace(drive, log=replace(drive.log, reference=reference))


def _arena(drive: Drive, rows: NDArray[np.intp], estimate: Array | None) -> tuple[float, float, float, float]:
    places = [drive.truth[..., rows, :2].reshape(-1, 2)]
    if estimate is not None:
        places.append(estimate[..., :2].reshape(-1, 2))
    seen = np.concatenate(places)
    seen = seen[np.isfinite(seen).all(axis=1)]
    reach = MARGIN + _reach(drive)
    (x_min, y_min), (x_max, y_max) = (seen.min(axis=0) - reach).tolist(), (seen.max(axis=0) + reach).tolist()
    return x_min, x_max, y_min, y_max


def _reach(drive: Drive) -> float:
    robots = drive.vehicle.modules if isinstance(drive.vehicle, TrainDescription) else (drive.vehicle,)
    return max(float(np.hypot(*castor.pivot)) + castor.offset for robot in robots for castor in robot.castors)


def _shape(drive: Drive, k: int) -> list[float] | list[Array] | Array:
    """Return the castors' angles at a sample, those that no encoder tells 0; of a train the shape of each frame."""
    if isinstance(drive.vehicle, RobotDescription):
        return np.nan_to_num(castor_angles(Geometry.of(drive.vehicle), drive.log.pivot[drive.samples[k]]))
    poses, lengths = drive.truth[:, k], [frame.length for frame in drive.vehicle.frames]
    return [
        frame_curve(rear, front, length)[:, :2]
        for front, rear, length in zip(poses[:-1], poses[1:], lengths, strict=True)
    ]


def _save(path: Path, form: str, pictures: list[NDArray[np.uint8]]) -> None:
    """Write pictures as one file, whole or not at all; raises InputError where `check_picture` does."""
    from PIL import Image, PngImagePlugin  # comes with matplotlib

    check_picture(f"--{form.lower()}", path)
    first, *others = (Image.fromarray(picture) for picture in pictures)
    out = io.BytesIO()
    if form == "GIF":
        flat = [image.quantize(64) for image in (first, *others)]
        flat[0].save(
            out, form, save_all=True, append_images=flat[1:], duration=PERIOD, loop=0, optimize=True, comment=MARK
        )
    else:
        text = PngImagePlugin.PngInfo()
        text.add_text("Software", MARK.decode())
        first.save(out, form, pnginfo=text)
    with writing(f"--{form.lower()} {path}"):
        write_atomically(path, out.getvalue())
