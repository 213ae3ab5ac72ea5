"""The stability scoreboard in a run's report: read from the `stability.json` that `prt-bench stability --out` leaves there."""

import json
from pathlib import Path
from typing import Any

from prt_bench.errors import DatasetError

FILE = "stability.json"
SCHEMA = 1


def read_scoreboard(run_dir: Path) -> dict[str, Any] | None:
    """Goals, a row of counts per case, the cells that failed and the mutants; None where the run has no scoreboard.

    Raises `DatasetError` when the file is not a scoreboard of this schema.
    """
    path = run_dir / FILE
    if not path.is_file():
        return None
    try:
        board = json.loads(path.read_text(encoding="utf-8"))
        if board["schema"] != SCHEMA:
            raise ValueError(f"schema {board['schema']}")
        routes = list(dict.fromkeys(cell["route"] for cell in board["cells"]))
        return {
            "goals": board["goals"],
            "routes": routes,
            "rows": _rows(board["cells"], routes),
            "failed": [cell for cell in board["cells"] if cell["outcome"].startswith("failed")],
            "mutants": board["mutants"],
            "commit": board["provenance"].get("commit"),
        }
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise DatasetError(f"{path} is not a stability scoreboard; 'prt-bench stability --out' writes one") from error


def _rows(cells: list[dict[str, Any]], routes: list[str]) -> list[dict[str, Any]]:
    """One row per case and kind: for each route the cells that hold, of all."""
    grouped: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for cell in cells:
        grouped.setdefault((cell["case"], cell["title"], cell["kind"]), []).append(cell)
    rows = []
    for (case, title, kind), members in grouped.items():
        counts = []
        for route in routes:
            outcomes = [cell["outcome"] for cell in members if cell["route"] == route]
            sound = sum(not outcome.startswith("failed") for outcome in outcomes)
            counts.append({"sound": sound, "all": len(outcomes)})
        headroom = max((cell["headroom"] for cell in members if cell["headroom"] is not None), default=None)
        rows.append({"case": case, "title": title, "kind": kind, "counts": counts, "headroom": headroom})
    return rows
