"""Files are whole or not there, and what killed writers left is distinguished from what is being written."""

import os
import signal
import subprocess
import sys
import time

import pytest

from castor_envs.files import LEFT_OVER, check_writable, new_folder, remove_leftovers, write_atomically

WRITER = """
import os, sys
from pathlib import Path
from castor_envs.files import write_atomically
def wait(descriptor):
    print("writing", flush=True)
    sys.stdin.read()
os.fsync = wait
write_atomically(Path(sys.argv[1]), "whole")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs file locks")
def test_the_temporary_file_of_a_killed_writer_is_removed_and_that_of_a_living_one_stays(tmp_path):
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, tmp_path / name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for name in ("killed.json", "living.json")
    ]
    for writer in writers:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "writing\n"
    killed, living = writers
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    assert len(list(tmp_path.iterdir())) == 2
    remove_leftovers(tmp_path)
    (kept,) = tmp_path.iterdir()
    assert kept.name.startswith(".living.json.")
    living.communicate("")
    assert [path.name for path in tmp_path.iterdir()] == ["living.json"]
    assert (tmp_path / "living.json").read_text() == "whole"
    killed.communicate()


def test_without_locks_age_tells(tmp_path, monkeypatch):
    monkeypatch.setattr("castor_envs.files.fcntl", None)
    for name, age in ((".old.json.abcd_123.tmp", LEFT_OVER + 60), (".new.json.abcd_123.tmp", 0)):
        (tmp_path / name).write_text("half")
        os.utime(tmp_path / name, (time.time() - age, time.time() - age))
    remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".new.json.abcd_123.tmp"]
    write_atomically(tmp_path / "file", "whole")
    assert (tmp_path / "file").read_text() == "whole"


def test_a_file_that_does_not_fit_is_named_and_leaves_what_was_there(tmp_path):
    """As on a full disk: here the system refuses files over a size."""
    resource = pytest.importorskip("resource")
    path = tmp_path / "file"
    write_atomically(path, "before")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match="too large") as raised:
            write_atomically(path, "x" * 2000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert raised.value.filename == str(path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


FILLER = """
import sys
from pathlib import Path
import typer
from castor_envs.cli import command_line
from castor_envs.files import new_folder
app = typer.Typer()
@app.command()
def fill(out: Path):
    with new_folder(out) as partial:
        (partial / "half").write_text("")
        print("writing", flush=True)
        sys.stdin.read()
command_line.main(app)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs file locks and signals")
def test_a_folder_half_filled_goes_with_ctrl_c_and_that_of_a_killed_process_with_the_next(tmp_path):
    out = tmp_path / "out [1]"

    def filling():
        process = subprocess.Popen(
            [sys.executable, "-c", FILLER, out],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # which a shell's background jobs ignore
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        return process

    stopped, killed, living = filling(), filling(), filling()
    assert len(list(tmp_path.iterdir())) == 3
    stopped.send_signal(signal.SIGINT)
    assert stopped.wait(timeout=60) == 130
    assert len(list(tmp_path.iterdir())) == 2
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    with new_folder(out) as partial:
        names = {path.name for path in tmp_path.iterdir()}
        assert names == {partial.name, f".{out.name}.{living.pid}.partial"}
        (partial / "mine").write_text("")
    living.kill()
    for process in (stopped, killed, living):
        process.communicate()
    assert [path.name for path in out.iterdir()] == ["mine"]


def test_what_cannot_be_written_is_known_before_and_nothing_is_left(tmp_path):
    check_writable(tmp_path / "deep" / "in" / "it.json")
    check_writable(tmp_path / "it.json")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "there.json").write_text("as it was")
    check_writable(tmp_path / "there.json")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "there.json" / "it.json", tmp_path / "folder"):
        with pytest.raises(OSError, match=r"Not a directory|Is a directory|File exists"):
            check_writable(path)
    assert {path.name for path in tmp_path.iterdir()} == {"folder", "there.json"}
    assert (tmp_path / "there.json").read_text() == "as it was"
