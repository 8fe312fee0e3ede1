"""A diagnosis as files in a folder of its own."""

from pathlib import Path
from typing import Any

from castor_envs.files import new_folder, write_atomically, write_json
from castor_envs.vehicles.load import Vehicle, file_name


def write_diagnosis(out: Path, data: dict[str, Any], found: Vehicle | None, page: str) -> None:
    """Write diagnosis.json, report.html and what is named, as robot.json or train.json, to a new folder; or nothing."""
    with new_folder(out) as partial:
        write_json(partial / "diagnosis.json", data)
        write_atomically(partial / "report.html", page)
        if found is not None:
            found.save(partial / file_name(found))
