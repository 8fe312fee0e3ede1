"""What a stored episode depends on: all code that had a part in recording it."""

import subprocess
import sys

from benchmarks.results.provenance import world_files

RECORDS = """
import sys
from benchmarks.tasks import official_tasks, select_tasks

for task, case in (("configuration-static", "test-1"), ("configuration-history", 0), ("manoeuvres-differential", 0)):
    (found,) = select_tasks(official_tasks(), [task])
    found.record(case)
for name, module in sorted(sys.modules.items()):
    if name.partition(".")[0] in ("castor_envs", "estimators", "benchmarks") and getattr(module, "__file__", None):
        print(name, module.__file__)
"""


def test_all_code_that_records_is_what_tells_one_world_from_another():
    """Truth, references and oracles come from estimators too; what only draws has no part in it."""
    loaded = subprocess.run(
        [sys.executable, "-P", "-c", RECORDS], capture_output=True, text=True, check=True, timeout=600
    )
    files = dict(line.split(" ", 1) for line in loaded.stdout.splitlines())
    assert {"estimators.likelihood.trains.bending", "estimators.robots.cast", "benchmarks.tasks.task"} <= set(files)
    known = {str(path) for path in world_files()}
    drawing = {name for name in files if name.startswith("castor_envs.rendering")}
    assert {name for name, file in files.items() if file not in known} - drawing == {"benchmarks"}
