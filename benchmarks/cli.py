"""``castor-bench``: run the benchmark, show the leaderboard, check an estimator."""

from castor_envs.cli import command_line
from castor_envs.cli.commands import Commands


class BenchCommands(Commands):
    """The commands of ``castor-bench``, in the order in which help lists them."""

    table = {  # noqa: RUF012
        "run": "benchmarks.commands.run:run",
        "leaderboard": "benchmarks.commands.results:leaderboard",
        "check": "benchmarks.commands.check:check",
        "rescore": "benchmarks.commands.results:rescore",
        "forget": "benchmarks.commands.results:forget_rows",
        "export": "benchmarks.commands.results:export",
        "tables": "benchmarks.commands.tables:tables",
        "calibrate": "benchmarks.commands.logs:calibrate",
        "import": "benchmarks.commands.logs:import_data",
        "drive": "benchmarks.commands.drive:drive_by_hand",
        "robot": "benchmarks.commands.robot:robot_file",
        "speed": "benchmarks.commands.speed:speed",
        "list": "benchmarks.commands.known:list_known",
        "show": "benchmarks.commands.show:show",
        "compare": "benchmarks.commands.show:compare",
        "page": "benchmarks.commands.show:page",
    }


app = command_line.new_app(BenchCommands)


@app.callback()
def options(version: command_line.Version = False, traceback: command_line.Traceback = False) -> None:
    """Benchmark of odometry and localisation for robots on castors and trains."""


def main() -> None:
    """Run the console script."""
    command_line.main(app)
