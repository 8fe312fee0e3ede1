"""Draw the rooms of the house and their imports into docs/architecture.md: ``python scripts/make_architecture.py``.

A room is a folder of one of the five packages, or a module that stands in none. An arrow means that a room imports
another one; where a longer way says the same (A imports B, B imports C, so A may import C), the short one is left out.
Rooms that nearly all import, which hold errors and files, are not drawn.
"""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
START, END = "<!-- picture: made by scripts/make_architecture.py -->\n", "<!-- end of picture -->\n"
PACKAGES = ("castor_cli", "castor_envs", "estimators", "benchmarks", "discrepancy")
EVERYWHERE = {"errors", "files", "discovery", "processes", "__init__", "__main__", "progress"}
TOGETHER = {"discrepancy/validation": "discrepancy/hypotheses"}
"""Rooms that import each other, drawn as one."""


def imports() -> dict[str, set[str]]:
    """Return for each room, as ``package/room``, the rooms that its modules import, wherever the import stands."""
    graph: dict[str, set[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if (importer := room_of(".".join(path.relative_to(ROOT).with_suffix("").parts))) is None:
                continue
            graph.setdefault(importer, set())
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.module is not None:
                    names = [f"{node.module}.{alias.name}" for alias in node.names]
                graph[importer] |= {room for name in names if (room := room_of(name)) not in (None, importer)}
    return graph


def room_of(module: str) -> str | None:
    """Return the room of a module, or of a name in it, given by its dotted name; None where none is drawn."""
    package, *rest = module.split(".")
    if package not in PACKAGES or not rest or rest[0] in EVERYWHERE:
        return None
    folder = ROOT / package / rest[0]
    room = f"{package}/{rest[0]}"
    return TOGETHER.get(room, room) if folder.is_dir() or folder.with_suffix(".py").is_file() else None


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the graph without the arrows that follow from others; raises graphlib.CycleError for a circle."""
    reached: dict[str, set[str]] = {}
    for room in TopologicalSorter(graph).static_order():
        reached[room] = set().union(*({other} | reached[other] for other in graph.get(room, ())))
    return {
        room: {other for other in others if not any(other in reached[way] for way in others)}
        for room, others in graph.items()
    }


def picture() -> str:
    """Return the picture as a Mermaid flow chart in Markdown."""
    graph = reduced(imports())
    lines = ["```mermaid", "flowchart BT"]
    for package in PACKAGES:
        lines.append(f"  subgraph {package}")
        lines += [f"    {node(room)}[{title(room)}]" for room in sorted(graph) if room.startswith(f"{package}/")]
        lines.append("  end")
    lines += [f"  {node(room)} --> {node(other)}" for room in sorted(graph) for other in sorted(graph[room])]
    return "\n".join([*lines, "```", ""])


def node(room: str) -> str:
    """Return a room's name in the chart."""
    return room.replace("/", "_")


def title(room: str) -> str:
    """Return what is written on a room: its name, and those of the rooms that are drawn with it."""
    rooms = [room, *(other for other, home in TOGETHER.items() if home == room)]
    return ", ".join(name.split("/")[1] for name in rooms)


def with_picture(page: str) -> str:
    """Return the page with a new picture between its marks."""
    before, rest = page.split(START)
    return before + START + picture() + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(with_picture(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
