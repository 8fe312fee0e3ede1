"""``castor-diagnose``: which command is which module's, and how its command line is read."""

from typing import Any

from typer.core import TyperCommand

from castor_envs.cli import command_line
from castor_envs.cli.commands import Commands


class SeveralEach(TyperCommand):
    """Lets every option that may come several times take several values: --holdout a.csv b.csv."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Name the option again before each further value."""
        several = {name for option in self.params if getattr(option, "multiple", False) for name in option.opts}
        spelled: list[str] = []
        last, values = None, 0
        for arg in args:
            if arg.startswith("-") and arg != "-":
                last, values = (arg if arg in several else None), 0
            elif last is not None:
                values += 1
                spelled += [last] if values > 1 else []
            spelled.append(arg)
        return super().parse_args(ctx, spelled)


class DiagnoseCommands(Commands):
    """The commands of ``castor-diagnose``; takes `castor-diagnose LOG...` as `castor-diagnose find LOG...`."""

    table = {  # noqa: RUF012
        "inspect": "discrepancy.commands.inspect:inspect",
        "find": "discrepancy.commands.find:find",
        "trial": "discrepancy.commands.trial:trial",
    }
    kind = SeveralEach

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `find` before what is neither a command nor an option of all."""
        if args and args[0] not in {*self.table, *self.get_help_option_names(ctx), "--version"}:
            args = ["find", *args]
        return super().parse_args(ctx, args)


app = command_line.new_app(DiagnoseCommands)


@app.callback()
def options(version: command_line.Version = False, traceback: command_line.Traceback = False) -> None:
    """Find where a robot's description and its measurements disagree."""


def main() -> None:
    """Run the console script."""
    command_line.main(app)
