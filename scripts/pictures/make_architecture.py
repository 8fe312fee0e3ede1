"""Draw docs/architecture.svg, rooms of the house and imports: ``python scripts/pictures/make_architecture.py``.

A room is a folder of one of the four packages, or a module that stands in none. A line means that the upper room
imports the lower one; where a longer way says the same (A imports B, B imports C, so A may import C), the short one is
left out. Rooms that nearly all import, which hold errors and files, are not drawn.
"""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "architecture.svg"
COLORS = {
    "castor_envs": "#00629b",
    "estimators": "#0a7d5c",
    "benchmarks": "#a8551a",
    "discrepancy": "#8d4a9e",
}
PACKAGES = tuple(COLORS)
WIDTH, MARGIN, STEP, HEIGHT, ROUNDS = 1240, 30, 68, 26, 24
"""Units of the picture: its width, its margin, from layer to layer, of a room; how often layers are put in order."""
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
    """Return the picture as SVG: rooms in layers, each above all that it imports, packages side by side as far as that
    allows."""
    graph = reduced(imports())
    layers = ordered(graph)
    place = {
        room: (MARGIN + (k + 0.5) * (WIDTH - 2 * MARGIN) / len(layer), MARGIN + (len(layers) - 1 - n) * STEP)
        for n, layer in enumerate(layers)
        for k, room in enumerate(layer)
    }
    height = 2 * MARGIN + (len(layers) - 1) * STEP + HEIGHT
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height + 40}" font-family="sans-serif">',
        "<title>Rooms of the four packages, and which imports which</title>",
        f'<rect width="{WIDTH}" height="{height + 40}" rx="6" fill="#ffffff"/>',
    ]
    for room in sorted(graph):
        for other in sorted(graph[room]):
            (x, y), (u, v) = place[room], place[other]
            y += HEIGHT
            bend = min(60.0, (v - y) / 2)
            lines.append(
                f'<path d="M{x:.0f} {y:.0f}C{x:.0f} {y + bend:.0f} {u:.0f} {v - bend:.0f} {u:.0f} {v:.0f}" '
                f'fill="none" stroke="{COLORS[room.split("/")[0]]}" stroke-width="1.3" stroke-opacity=".55"/>'
            )
    for room, (x, y) in sorted(place.items()):
        wide = 9 * len(title(room)) + 16
        lines.append(
            f'<rect x="{x - wide / 2:.0f}" y="{y:.0f}" width="{wide}" height="{HEIGHT}" rx="4" '
            f'fill="{COLORS[room.split("/")[0]]}"/><text x="{x:.0f}" y="{y + 18:.0f}" text-anchor="middle" '
            f'font-size="14" fill="#ffffff">{title(room)}</text>'
        )
    for k, (package, color) in enumerate(COLORS.items()):
        lines.append(
            f'<rect x="{MARGIN + 170 * k}" y="{height}" width="16" height="16" rx="3" fill="{color}"/>'
            f'<text x="{MARGIN + 24 + 170 * k}" y="{height + 13}" font-size="14" fill="#22262b">{package}</text>'
        )
    return "\n".join([*lines, "</svg>", ""])


def ordered(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the rooms in layers, those that import nothing first.

    In a layer each stands near what it imports and what imports it: by the mean of their places, over and over.
    """
    depth: dict[str, int] = {}
    for room in TopologicalSorter(graph).static_order():
        depth[room] = 1 + max((depth[other] for other in graph.get(room, ())), default=-1)
    layers = [sorted(room for room in depth if depth[room] == n) for n in range(max(depth.values()) + 1)]
    near = {room: set(graph.get(room, ())) | {other for other in graph if room in graph[other]} for room in depth}
    for _ in range(ROUNDS):
        for layer in layers:
            at = {room: (k + 0.5) / len(row) for row in layers for k, room in enumerate(row)}
            layer.sort(key=lambda room: (sum(at[other] for other in near[room]) / max(len(near[room]), 1), room))
    return layers


def title(room: str) -> str:
    """Return what is written on a room: its name, and those of the rooms that are drawn with it."""
    rooms = [room, *(other for other, home in TOGETHER.items() if home == room)]
    return ", ".join(name.split("/")[1] for name in rooms)


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
