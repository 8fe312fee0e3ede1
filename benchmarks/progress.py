"""How a run reports its progress: not at all, or with a bar in the terminal."""

from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn


class RunProgress(Protocol):
    """Receives the progress of a run."""

    def start(self, stage: str, total: int) -> None:
        """Start a stage of `total` steps."""
        ...

    def advance(self, steps: int = 1) -> None:
        """Count steps of the stage as done."""
        ...

    def warn(self, message: str) -> None:
        """Show a message that the user should read."""
        ...


class SilentProgress:
    """Progress that is not shown."""

    def start(self, stage: str, total: int) -> None:
        """Do nothing."""

    def advance(self, steps: int = 1) -> None:
        """Do nothing."""

    def warn(self, message: str) -> None:
        """Do nothing."""


class TerminalProgress:
    """A bar for each stage, and warnings, on stderr. Use it as a context."""

    def __init__(self):
        self._console = Console(stderr=True)
        columns = (
            TextColumn("{task.description:<22}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
        )
        self._bars = Progress(*columns, console=self._console)
        self._bar = None

    def __enter__(self) -> "TerminalProgress":
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def start(self, stage: str, total: int) -> None:
        """Show a new bar; none for a stage without steps."""
        self._bar = self._bars.add_task(stage, total=total) if total else None

    def advance(self, steps: int = 1) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bars.advance(self._bar, steps)

    def warn(self, message: str) -> None:
        """Print a line above the bars."""
        self._console.print(f"warning: {message}", markup=False, highlight=False, soft_wrap=True)
