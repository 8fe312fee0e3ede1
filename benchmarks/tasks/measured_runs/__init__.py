"""Boards of measured robots: estimators follow test runs of every session in a folder, nominal and calibrated.

Sources are those of the importers (`castor_envs.logs.importers`). The data are not part of this project.
"""

from pathlib import Path

from benchmarks.tasks.measured_runs.task import MeasuredDrives
from benchmarks.tasks.task import Task
from castor_envs.vehicles.robot import RobotDescription

OPTIODOM = "DIR holds data/ of the public repository sousarbarb/optiodom as optiodom/"
ROBOTINO = "DIR holds the public repository BrOleg5/research-wheel-slippage as robotino/"
SPLIT = (
    "Each session's runs are divided, those that turn left and those that turn right each by turns, a single one in "
    "the middle of its time; one part calibrates, the other tests. The reference's clock and mount are corrected, "
    "whichever the robot file; what calibration does not find to fit keeps the makers' numbers."
)
ONE_ROBOT = (
    "Straight drives over one floor or two; every other run tests. Robot and camera's mount are calibrated on the "
    "floor where wheels slip least, as a scale that is fitted to slip is none."
)


def is_differential(robot: RobotDescription) -> bool:
    """Return whether two wheels on a fixed axle drive the robot."""
    return all(castor.steering == "fixed" for castor in robot.castors) and not is_omni(robot)


def is_tricycle(robot: RobotDescription) -> bool:
    """Return whether a castor of the robot is steered."""
    return any(castor.steering == "driven" for castor in robot.castors)


def is_omni(robot: RobotDescription) -> bool:
    """Return whether the robot stands on omni wheels."""
    return all(wheel.grip == "omni" for wheel in robot.wheels)


BY_METRE, ALONG_PATH = ("rpe_translation", 1.2), ("ate", 0.3)
"""Metric that ranks, and least true path of a test run, m. Robotino's runs hardly reach 1 m."""

ROBOTS = (
    ("measured-differential", "differential robot", "optiodom", is_differential, "differential", OPTIODOM, BY_METRE),
    ("measured-tricycle", "tricycle", "optiodom", is_tricycle, "tricycle", OPTIODOM, BY_METRE),
    ("measured-omni", "robot on three omni wheels", "optiodom", is_omni, "omni3", OPTIODOM, BY_METRE),
    *(
        (f"measured-raw-{short}", f"{title}, unsynchronised", "optiodom-raw", layout, like, OPTIODOM, BY_METRE)
        for short, title, layout, like in (
            ("differential", "differential robot", is_differential, "differential"),
            ("tricycle", "tricycle", is_tricycle, "tricycle"),
            ("omni", "robot on three omni wheels", is_omni, "omni3"),
        )
    ),
    ("measured-robotino", "Robotino on slippery floors", "robotino", is_omni, "omni3", ROBOTINO, ALONG_PATH),
)
"""Name, title, importer, layout, preset, source, metric and least path."""


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the tasks on drives of measured robots; they say where data are missing."""
    return tuple(
        MeasuredDrives(
            name=f"{name}-{'calibrated' if calibrated else 'nominal'}",
            title=f"Measured {title}, {'calibrated' if calibrated else 'nominal'} dimensions",
            description=(
                f"Every session of the folder. {ONE_ROBOT if importer == 'robotino' else SPLIT} Robot file: "
                + ("as maximum likelihood calibrates it." if calibrated else "as its makers describe it.")
            ),
            data=measured,
            importer=importer,
            layout=layout,
            like=like,
            source=source,
            calibrated=calibrated,
            metric=metric,
            way=way,
            one_robot=importer == "robotino",
        )
        for name, title, importer, layout, like, source, (metric, way) in ROBOTS
        for calibrated in (False, True)
    )
