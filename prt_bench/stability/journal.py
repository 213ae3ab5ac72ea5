"""Cells that are done, kept in a file while a scoreboard is at work, so that it can be interrupted and goes on.

The first line tells the code that judged them; cells of other code are not taken over.
"""

import hashlib
import json
from dataclasses import asdict
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from prt_bench.stability.cell import Cell

Name = tuple[str, str, str, str, str]


def name_of(cell: Cell) -> Name:
    """What tells a cell from others: case, title, kind, subject, route."""
    return cell.case, cell.title, cell.kind, cell.subject, cell.route


class Journal:
    """Cells by name, and a file that each new one is appended to; a line that was cut off ends what is read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cells: dict[Name, Cell] = {}
        head = {"code": _code()}
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        whole = [parsed for line in lines if (parsed := _parsed(line)) is not None]
        if whole[:1] == [head]:
            self.cells = {name_of(cell): cell for cell in (Cell(**each) for each in whole[1:])}
        kept = "".join(json.dumps(each) + "\n" for each in (head, *map(asdict, self.cells.values())))
        path.write_text(kept, encoding="utf-8")

    def add(self, cell: Cell) -> None:
        """Keep one more cell."""
        self.cells[name_of(cell)] = cell
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(cell)) + "\n")

    def done(self) -> None:
        """Remove the file: the scoreboard is written."""
        self.path.unlink(missing_ok=True)


def _parsed(line: str) -> dict | None:
    try:
        return json.loads(line)
    except json.JSONDecodeError:
        return None


def _code() -> str:
    """A hash of the product's Python files and of the libraries that compute."""
    found = hashlib.sha256()
    for package in ("prt_bench", "data_gen"):
        root = Path(str(files(package)))
        for path in sorted(root.rglob("*.py")):
            found.update(str(path.relative_to(root)).encode() + path.read_bytes())
    for library in ("jax", "jaxlib", "numpy", "scipy", "embreex"):
        found.update(version(library).encode())
    return found.hexdigest()
