"""A diagnosis as files in a folder of its own."""

import os
import shutil
from pathlib import Path
from typing import Any

from castor_envs.description import fingerprint
from castor_envs.errors import InputError
from castor_envs.files import write_atomically, write_json
from castor_envs.vehicles.load import Vehicle, file_name


def write_diagnosis(out: Path, data: dict[str, Any], found: Vehicle | None, page: str) -> None:
    """Write diagnosis.json, report.html and what is named, as robot.json or train.json, to a new folder; or nothing."""
    partial = out.with_name(f".{out.name}.{fingerprint(data)}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        os.makedirs(partial)
        write_json(partial / "diagnosis.json", data)
        write_atomically(partial / "report.html", page)
        if found is not None:
            found.save(partial / file_name(found))
        partial.rename(out)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise InputError(f"--out {out}: cannot be written to ({error.strerror or error})") from None
