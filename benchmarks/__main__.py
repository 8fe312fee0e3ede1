"""Where ``castor-bench`` starts: Ctrl-C ends it silently while it imports the rest."""

import os
import signal


def main() -> None:
    """Run the console script."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    from benchmarks.cli import main as run

    run()


if __name__ == "__main__":
    main()
