"""A group of commands, each imported when it is run: help lists them all and imports none."""

import ast
import importlib
import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from castor_envs.errors import did_you_mean


class Commands(TyperGroup):
    """Commands by name, each a function of a module, given as "module:function".

    A function's parameters are the command's, as Typer reads them; the first paragraph of its docstring is what help of
    the whole group says, taken from the source.
    """

    table: ClassVar[Mapping[str, str]]
    kind: ClassVar[type[TyperCommand]] = TyperCommand

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, in the order of the table."""
        return list(self.table)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return what help of the group shows of a command, without its parameters; None for an unknown name."""
        if cmd_name not in self.table:
            return None
        said = " ".join(_docstring(self.table[cmd_name]).partition("\n\n")[0].split())
        return TyperCommand(cmd_name, short_help=said, rich_markup_mode=self.rich_markup_mode)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that is run, imported."""
        if args and args[0] not in self.table and not args[0].startswith("-"):
            ctx.fail(f"no such command {args[0]!r}{did_you_mean(args[0], self.table)}")
        name, listed, rest = super().resolve_command(ctx, args)
        return name, listed if listed is None else self.imported(listed.name or ""), rest

    def imported(self, name: str) -> Any:
        """Return a command with its parameters."""
        module, function = self.table[name].split(":")
        alone = typer.Typer(
            add_completion=False, rich_markup_mode=self.rich_markup_mode, pretty_exceptions_enable=False
        )
        alone.command(name, cls=self.kind)(getattr(importlib.import_module(module), function))
        return typer.main.get_command(alone)


def imported(app: typer.Typer) -> dict[str, Any]:
    """Return all commands of an app by name, with their parameters."""
    group: Any = typer.main.get_command(app)
    return {name: group.imported(name) for name in group.table}


def _docstring(place: str) -> str:
    """Return the docstring of a function, "module:function", from the module's source."""
    module, function = place.split(":")
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    defined = ast.parse(Path(spec.origin).read_bytes()).body
    (found,) = (node for node in defined if isinstance(node, ast.FunctionDef) and node.name == function)
    return ast.get_docstring(found) or ""
