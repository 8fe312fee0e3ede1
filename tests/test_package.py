"""The package's metadata: addresses of the repository, where git knows one."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

ROOT = Path(__file__).parents[1]
HOOK = "scripts/package_addresses.py"
FILES = ("pyproject.toml", "README.md", "LICENSE", "castor_envs/__init__.py", HOOK)
PAGES = "https://forge.example/team/castor-envs"


def metadata_of(folder, remote):
    """The metadata of a clone from `remote`; of a folder without a repository for None."""
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    if remote is not None:
        subprocess.run(["git", "init", "-q", str(folder)], check=True)
        subprocess.run(["git", "-C", str(folder), "remote", "add", "origin", remote], check=True)
    return ProjectMetadata(str(folder), PluginManager()).core


@pytest.mark.parametrize(
    "remote",
    [
        PAGES,
        f"{PAGES}.git",
        "https://user:secret@forge.example/team/castor-envs.git",
        "git@forge.example:team/castor-envs.git",
        "ssh://git@forge.example:2222/team/castor-envs.git",
    ],
)
def test_addresses_are_those_of_the_remote(tmp_path, remote):
    core = metadata_of(tmp_path, remote)
    assert core.urls["Repository"] == PAGES
    assert core.urls["Changelog"] == f"{PAGES}/blob/HEAD/CHANGELOG.md"
    assert f"]({PAGES}/raw/HEAD/docs/pictures/umbmark.gif)" in core.readme
    assert f"]({PAGES}/blob/HEAD/docs/benchmark.md#tasks)" in core.readme
    assert re.findall(r"\]\((?!https://)[^)]*\)", core.readme) == []
    assert "secret" not in core.readme + str(core.urls)


@pytest.mark.parametrize("remote", [None, "/home/me/castor-envs", "../castor-envs", "file:///home/me/castor-envs"])
def test_without_a_published_repository_links_stay_as_they_are(tmp_path, remote):
    core = metadata_of(tmp_path, remote)
    assert core.urls == {}
    assert core.readme == (ROOT / "README.md").read_text("utf-8")


def test_a_copy_in_another_repository_has_not_its_addresses(tmp_path):
    metadata_of(tmp_path, PAGES)
    assert metadata_of(tmp_path / "vendored", None).urls == {}
