"""``castor-bench list``."""

from benchmarks.tasks import official_tasks, tasks_by_group
from castor_envs.vehicles.load import load_robot, load_train
from castor_envs.vehicles.presets import preset_names, train_names
from estimators.plugins.registry import CALIBRATION, ESTIMATOR, builtin_names


def list_known() -> None:
    """List tasks, estimators, calibration methods, robots and trains."""
    print("tasks by group (castor-bench run --group), * where run needs the task's name or group:")
    for group, tasks in tasks_by_group(official_tasks()).items():
        print(f"  {group}")
        for task in tasks:
            print(f"  {' ' if task.standard else '*'} {task.name}  (version {task.version})  {task.title}")
    for heading, kind in (("estimators", ESTIMATOR), ("calibration methods", CALIBRATION)):
        print(f"{heading}:")
        for name in kind.names():
            print(f"  {name}")
    print("robots:")
    for name in preset_names():
        print(f"  {name}: {', '.join(builtin_names(load_robot(name))) or 'no built-in estimator applies'}")
    print("trains:")
    for name in train_names():
        print(f"  {name}: {', '.join(builtin_names(load_train(name))) or 'no built-in estimator applies'}")
