"""Addresses in the package's metadata: where its repository is published, as git's remote `origin` says.

A package index shows README.md away from the repository, so its images and links need whole addresses there; in the
repository, and for a clone of a folder, they stay as they are.
"""

import re
import subprocess
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

HOST = re.compile(
    r"(?:https?://(?:[^@/]*@)?|ssh://(?:[^@/]*@)?|[\w.-]+@)(?P<host>[\w.-]+)(?::\d+)?[:/](?P<path>[\w./~-]+?)(?:\.git)?/?"
)
"""The forms of a remote's address: https, ssh, and user@host:path. Users, passwords and ports are left out."""

LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<path>(?!\w+:|#|/)[^)\s]+)\)")
"""A link, or an image, to a file of the repository."""


class Addresses(MetadataHookInterface):
    """Sets `urls` and `readme`, which are dynamic."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add them to the project's metadata."""
        repository, text = repository_of(Path(self.root)), Path(self.root, "README.md").read_text("utf-8")
        metadata["urls"] = {} if repository is None else urls_of(repository)
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": text if repository is None else with_whole_addresses(text, repository),
        }


def repository_of(root: Path) -> str | None:
    """Return the address of the pages of the repository at `root`; None if it has none, or git is not there."""
    if not (root / ".git").exists():  # a copy in a folder of another repository
        return None
    command = ["git", "-C", str(root), "config", "--get", "remote.origin.url"]
    try:
        remote = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    found = HOST.fullmatch(remote)
    return None if found is None else f"https://{found['host']}/{found['path']}"


def urls_of(repository: str) -> dict[str, str]:
    """Return the project's URLs."""
    return {
        "Repository": repository,
        "Documentation": f"{repository}/blob/HEAD/docs/index.md",
        "Changelog": f"{repository}/blob/HEAD/CHANGELOG.md",
        "Issues": f"{repository}/issues",
    }


def with_whole_addresses(text: str, repository: str) -> str:
    """Return a text in Markdown whose links to files of the repository, and images, have whole addresses."""

    def whole(link: re.Match[str]) -> str:
        kind = "raw" if link["image"] else "blob"
        return f"{link['image']}[{link['text']}]({repository}/{kind}/HEAD/{link['path']})"

    return LINK.sub(whole, text)
