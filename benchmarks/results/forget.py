"""Rows that are not wanted any more, as of an estimator that was a mistake."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from benchmarks.results.rows import ResultsStore
from benchmarks.tasks.task import Task
from castor_envs.errors import InputError, did_you_mean
from castor_envs.files import writing


def forget(results: Path, tasks: Sequence[Task], text: str, write: bool) -> dict[str, int]:
    """Remove the rows of an estimator, NAME or NAME@HASH, from a results folder; return their number, by task.

    HASH: the beginning of its source's hash; without, all its sources. write: False removes nothing. Raises InputError
    for an estimator without rows.
    """
    store, known, removed = ResultsStore(results), set(), {}
    name, _, source = text.rpartition("@")
    for task in tasks:
        rows = store.summaries(task.name, task.version)
        known |= {row.estimator for row in rows}
        chosen = [
            row
            for row in rows
            if row.estimator == text or (row.estimator == name and row.source_hash.startswith(source))
        ]
        for folder in {store.folder(task.name, task.version, row.estimator, row.source_hash) for row in chosen}:
            if write:
                with writing(str(folder)):
                    shutil.rmtree(folder)
        if chosen:
            removed[task.name] = len(chosen)
    if not removed:
        raise InputError(f"{text!r} has no rows in {results}{did_you_mean(text, known) if known else ''}")
    return removed
