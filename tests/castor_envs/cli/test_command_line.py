"""Console scripts: one line and an exit code for every error, and Ctrl-C ends all of it at any moment."""

import contextlib
import io
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from typer.main import get_command

import benchmarks.cli
import discrepancy.cli
from castor_envs.cli import command_line
from castor_envs.cli.commands import imported
from castor_envs.errors import InputError

SCRIPTS = Path(sys.executable).parent
COMMANDS = ("castor-bench", "castor-diagnose")


def an_app(fail):
    """Return an app with two commands, one of which calls `fail`."""
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.callback()
    def options(traceback: command_line.Traceback = False): ...

    @app.command("fail")
    def failing(files: list[str]):
        with command_line.keeping("what is done is kept: the same command continues"):
            fail()

    @app.command("show")
    def showing(words: list[str]):
        print(*words)

    return app


@pytest.fixture
def call(capsys):
    def run(fail, *arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(an_app(fail), [*arguments])
        return leaving.value.code, *capsys.readouterr()

    return run


def raises(error):
    def fail():
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("a.csv, line 3:\nmend it"), 2, "error: a.csv, line 3: mend it"),
        (
            ZeroDivisionError("not\nforeseen"),
            1,
            "error: unforeseen ZeroDivisionError: not foreseen; what is done is kept: the same command continues; "
            "run again with --traceback to see where it comes from",
        ),
        (
            OSError(28, "No space left on device", "rows/3.npz"),
            1,
            "error: rows/3.npz: No space left on device; make room; what is done is kept: the same command continues",
        ),
        (
            PermissionError(13, "Permission denied", "rows"),
            1,
            "error: rows: Permission denied; what is done is kept: the same command continues; "
            "run again with --traceback to see where it comes from",
        ),
        (KeyboardInterrupt(), 130, "stopped; what is done is kept: the same command continues"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_an_error_is_one_line_and_a_code(call, error, code, line):
    assert call(raises(error), "fail", "a") == (code, "", line + "\n")


@pytest.mark.parametrize(
    "arguments", [("--traceback", "fail", "a"), ("fail", "--traceback", "a"), ("fail", "a", "--traceback")]
)
def test_the_traceback_is_shown_where_it_is_asked_for(call, arguments):
    code, out, err = call(raises(ZeroDivisionError("why")), *arguments)
    assert (code, out) == (1, "")
    assert err.startswith("Traceback (most recent call last)")
    assert err.splitlines()[-1].startswith("error: unforeseen ZeroDivisionError: why; ")


def test_after_two_dashes_an_argument_is_one(call):
    assert call(None, "show", "--", "--traceback") == (0, "--traceback\n", "")


@pytest.fixture
def windows_file():
    """A file that a text goes to in the coding of Windows, to be read as bytes."""
    return io.TextIOWrapper(io.BytesIO(), encoding="cp1252", newline="\n", write_through=True)


def test_what_stdout_cannot_write_is_plainer_and_numbers_keep_their_sign(windows_file, capsys):
    with contextlib.redirect_stdout(windows_file), pytest.raises(SystemExit) as leaving:
        command_line.run(an_app(None), ["show", "\N{MINUS SIGN}1\N{DEGREE SIGN}", "\N{RIGHTWARDS ARROW}", "\udcff"])
    assert (leaving.value.code, windows_file.buffer.getvalue()) == (0, "-1\N{DEGREE SIGN} ? ?\n".encode("cp1252"))
    assert capsys.readouterr().err == ""


def test_what_says_that_it_is_utf_8_is_utf_8(windows_file):
    with contextlib.redirect_stdout(windows_file):
        command_line.print_in_utf8("\N{RIGHTWARDS ARROW}")
    assert windows_file.buffer.getvalue() == "\N{RIGHTWARDS ARROW}".encode()


def test_a_message_of_any_length_is_one_short_line(call):
    _, _, err = call(raises(RuntimeError("word " * 10**6)), "fail", "a")
    assert len(err) < 500
    assert "word …;" in err


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_has_no_room_is_one_line(command):
    with open("/dev/full", "w") as full:
        done = subprocess.run([SCRIPTS / command, "--help"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "error: No space left on device; make room\n"


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("arguments", [(), ("--help",)], ids=["nothing", "help"])
def test_help_that_nobody_reads_to_its_end_is_no_error(command, arguments):
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as pipe:
        done = subprocess.run([SCRIPTS / command, *arguments], stdout=pipe, stderr=subprocess.PIPE, text=True)
    assert done.stderr == ""


@pytest.mark.parametrize("app", [benchmarks.cli.app, discrepancy.cli.app], ids=COMMANDS)
def test_one_letter_asks_for_help_everywhere(app, capsys):
    def printed(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(app, [*arguments])
        assert leaving.value.code == 0
        return capsys.readouterr().out

    assert printed("-h") == printed("--help")
    for name in imported(app):
        assert printed(name, "-h") == printed(name, "--help")


@pytest.mark.parametrize(
    ("app", "arguments", "name"),
    [(benchmarks.cli.app, ("import",), "source"), (discrepancy.cli.app, ("inspect", "--robot", "omni3"), "logs")],
    ids=COMMANDS,
)
def test_what_is_missing_points_to_help(app, arguments, name, capsys):
    with pytest.raises(SystemExit) as leaving:
        command_line.run(app, [*arguments])
    assert leaving.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.lower().startswith(f"error: missing argument '{name}")
    assert line.endswith(f" {arguments[0]} --help.")


@pytest.mark.parametrize("app", [benchmarks.cli.app, discrepancy.cli.app], ids=COMMANDS)
def test_help_is_alike(app):
    """One style for both, every command and option explained, and options of one name in the same words."""
    group = get_command(app)
    assert getattr(group, "rich_markup_mode") is None  # noqa: B009 - a group, which the type does not show
    for name, command in imported(app).items():
        assert command.help, name
        for option in command.params:
            assert option.help, (name, option.name)
            assert option.help.endswith((".", ")")), (name, option.help)
            if "--json" in option.opts:
                assert re.fullmatch(r"Print JSON \(castor-[a-z-]+/\d+\)\.", option.help), (name, option.help)
            if "--jobs" in option.opts:
                assert option.help == "Worker processes; default: one for each core.", name


def processes_with(mark):
    """Return the processes that inherited an environment with this mark and have not ended."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (folder / "environ").read_bytes():  # empty once a process has ended
                found.append(folder.name)
        except OSError:
            continue
    return found


def wait_until(condition, process=None):
    for _ in range(6000):
        if condition():
            return
        assert process is None or process.poll() is None, "the command ended by itself"
        time.sleep(0.01)
    raise AssertionError("waited for a minute")


def imports(process, folder):
    return "numpy" in Path(f"/proc/{process.pid}/maps").read_text()


def records(process, folder):
    return any(folder.glob("kept/episodes/*/*.npz"))


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
@pytest.mark.parametrize(("moment", "whole_group"), [(imports, True), (records, True), (records, False)])
def test_ctrl_c_ends_a_run_and_all_its_processes(tmp_path, moment, whole_group):
    """whole_group: the signal goes to all processes of the terminal, as from a keyboard, else to the command alone."""
    said = "stopped; what is done is kept in kept: the same command continues\n" if moment is records else ""
    mark = f"MARK_OF_{tmp_path}"
    command = [SCRIPTS / "castor-bench", "run", "--jobs", "1", "--results", "kept"]
    command += ["--task", "umbmark-kinematic-calibrated"]
    process = subprocess.Popen(
        command,
        cwd=tmp_path,
        env={**os.environ, "MARK": mark},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # which a shell's background jobs ignore
    )
    try:
        wait_until(lambda: moment(process, tmp_path), process)
        (os.killpg if whole_group else os.kill)(process.pid, signal.SIGINT)
        out, err = process.communicate()
    finally:
        process.kill()
    assert (process.returncode, out) == (130, "")
    assert err.endswith(said)
    assert "Traceback" not in err
    wait_until(lambda: not processes_with(mark.encode()))
