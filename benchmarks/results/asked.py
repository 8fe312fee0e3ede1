"""What was asked for last, so that boards show that, not whichever version of an estimator has the newest rows.

RESULTS/rows/<task>@<version>/asked.json   by estimator: its source's hash, and the spec that named it
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from benchmarks.results.rows import RowSummary
from benchmarks.tasks.task import Task
from castor_envs.errors import InputError
from castor_envs.files import read_json, write_json

ASKED, FORMAT = "asked.json", "castor-asked/1"


@dataclass(frozen=True)
class Asked:
    """A version of an estimator or a method that a run asked for. spec: how, None where `shown_spec` says nothing."""

    source_hash: str
    spec: str | None = None


_ADAPTER = TypeAdapter(dict[str, Asked])


def asked(folder: Path) -> dict[str, Asked]:
    """Return what runs of a task asked for last, by name; nothing where that is not kept, or damaged.

    folder: that of the task's rows.
    """
    try:
        stored = read_json(folder / ASKED)
        return _ADAPTER.validate_python(stored["estimators"]) if stored["format"] == FORMAT else {}
    except (InputError, ValidationError, TypeError, LookupError):
        return {}


def keep_asked(folder: Path, given: Mapping[str, Asked]) -> None:
    """Keep what a run asks for, by name, beside what others asked for."""
    known = asked(folder)
    if given.items() - known.items():
        estimators = {name: asdict(one) for name, one in sorted({**known, **given}.items())}
        write_json(folder / ASKED, {"format": FORMAT, "estimators": estimators})


def latest_source(rows: Iterable[RowSummary], last: Asked | None) -> str:
    """Return the source of one estimator that counts: the one asked for last, if it has rows, else that of the newest.

    rows: one or more.
    """
    created = {row.source_hash: row.created for row in sorted(rows, key=lambda row: row.created)}
    if last is not None and last.source_hash in created:
        return last.source_hash
    return max(created, key=created.__getitem__)


def spec_of(task: Task) -> str | None:
    """Return the spec that named a task of others, as `shown_spec`; None of an official one."""
    spec = getattr(task, "spec", None)
    return None if spec is None else shown_spec(spec)


def asked_as(task: Task) -> str:
    """Return what names a task in the commands of a page: its spec, or its name where it has none that may be shown."""
    return spec_of(task) or task.name


def shown_spec(spec: str) -> str | None:
    """Return a spec as pages may show it, in which a file's path is one from the current folder.

    None of a file outside that an absolute path names: no page is to tell how somebody's machine is arranged.
    """
    base, mark, rest = spec.partition("?")
    named = re.fullmatch(r"(.*?\.py)(:.*)?", base)
    file = Path(named[1]) if named else Path()
    if named is None or not file.is_absolute():
        return spec
    if not file.is_relative_to(Path.cwd()):
        return None
    return f"{file.relative_to(Path.cwd())}{named[2] or ''}{mark}{rest}"
