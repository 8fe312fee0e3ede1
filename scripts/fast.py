"""Run the tests of what changed: ``python scripts/fast.py [REVISION]``, compared with a revision (HEAD).

The folders of tests/ mirror those of the packages: a changed module means the tests of its folder, a changed test means
itself. Slow tests (marked so) are left out; the house rules always run.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("castor_envs", "estimators", "benchmarks", "discrepancy")


def changed(revision: str) -> list[Path]:
    """Return the files that differ from a revision, new ones among them, from the project's folder."""
    calls = (["git", "diff", "--name-only", revision], ["git", "ls-files", "--others", "--exclude-standard"])
    lines = [subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=True).stdout for call in calls]
    return [Path(line) for text in lines for line in text.splitlines()]


def tests_of(path: Path) -> Path | None:
    """Return the tests of a changed file: itself, or the nearest folder in tests/ that mirrors its own."""
    if path.suffix != ".py" or not path.parts:
        return None
    if path.parts[0] == "tests":
        return path if path.name.startswith("test_") and (ROOT / path).is_file() else path.parent
    if path.parts[0] not in PACKAGES:
        return None
    return next(folder for folder in (Path("tests") / part for part in path.parents) if (ROOT / folder).is_dir())


def main() -> int:
    """Run pytest on the tests of what changed; returns its exit code."""
    revision = sys.argv[1] if len(sys.argv) > 1 else "HEAD"
    chosen = {tests for path in changed(revision) if (tests := tests_of(path)) is not None}
    folders = sorted({"tests/test_house.py", *map(str, chosen)})
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "2", "-m", "not slow", *folders], cwd=ROOT
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
