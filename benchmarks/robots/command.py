"""``castor-bench robot``: checks a robot's or a train's file, or asks for one; says and draws what it describes."""

import io
import json
import warnings
from pathlib import Path

from benchmarks.robots import summary
from benchmarks.robots.questions import asked
from castor_envs.errors import InputError
from castor_envs.files import check_writable, write_atomically, writing
from castor_envs.rendering.layout import layout_figure
from castor_envs.vehicles.load import Vehicle, load_vehicle
from castor_envs.vehicles.plausibility import remarks


def check_robot(file: str, png: Path | None, as_json: bool) -> bool:
    """Print what is wrong with a robot's or a train's file (or a preset), and what it says; return whether it is valid.

    png: where its layout is drawn, replacing what is there. Raises InputError for a file that cannot be read, or a
    picture that cannot be written.
    """
    _check_picture(png)
    if file.endswith(".json") and not Path(file).exists():
        raise InputError(f"{file}: there is no such file; --new asks for a robot and writes it")
    try:
        vehicle = load_vehicle(file)
    except InputError as error:
        if not Path(file).is_file():
            raise
        problems = summary.findings_of(error)
        if as_json:
            print(json.dumps({"format": summary.FORMAT, "valid": False, "problems": problems}, indent=2))
        else:
            print("\n".join(f"WRONG  {problem}" for problem in problems))
        return False
    if as_json:
        print(json.dumps(summary.as_data(vehicle), indent=2, allow_nan=False))
    else:
        print("\n".join([*summary.as_lines(vehicle), *_remarked(vehicle)]))
    if png is not None:
        draw(vehicle, png)
        if not as_json:
            print(f"drawn: {png}")
    return True


def new_robot(file: str, png: Path | None, force: bool) -> None:
    """Ask for a robot and write it to `file`.

    Raises InputError, before any question, where a file is there already, or none can be written.
    """
    _check_picture(png)
    path = Path(file)
    if path.suffix != ".json":
        raise InputError(f"{file}: robot files end in .json; name one")
    if path.exists() and not force:
        raise InputError(f"{file}: is there already; name a new file, or give --force to replace it")
    with writing(file):
        check_writable(path)
    robot = asked()
    with writing(file):
        robot.save(path)
    print(f"written: {file}; what was not asked for has its default (docs/formats.md)\n")
    check_robot(file, png, as_json=False)


def draw(vehicle: Vehicle, png: Path) -> None:
    """Draw a layout to a PNG file."""
    picture = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name in letters that the font lacks is drawn as boxes
        layout_figure(vehicle).savefig(picture, format="png", dpi=110)
    with writing(f"--png {png}"):
        write_atomically(png, picture.getvalue())


def _check_picture(png: Path | None) -> None:
    if png is not None:
        if png.suffix.lower() != ".png":
            raise InputError(f"--png {png}: pictures end in .png; name one")
        with writing(f"--png {png}"):
            check_writable(png)


def _remarked(vehicle: Vehicle) -> list[str]:
    found = remarks(vehicle)
    return [f"CHECK  {where}: {what}" for where, what in found] or ["ok     nothing odd in it"]
