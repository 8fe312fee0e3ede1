"""Writes the measured OptiOdom sessions as logs and robot files, a folder a session.

python scripts/export_measured.py DATA measured
"""

import argparse
from pathlib import Path

from castor_envs.logs.csv import write_log
from castor_envs.logs.importers.optiodom import find_sessions, read_session


def main() -> None:
    """Read every session under DATA and write its runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="a folder that holds optiodom/")
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    for name, path in find_sessions(given.data).items():
        session, folder = read_session(path), given.out / name
        folder.mkdir(parents=True, exist_ok=True)
        session.robot.save(folder / "robot.json")
        for number, run in enumerate(session.runs, start=1):
            write_log(folder / f"run-{number}.csv", run, session.robot)
        print(f"{folder}: {session.robot.name}, {len(session.runs)} runs")


if __name__ == "__main__":
    main()
