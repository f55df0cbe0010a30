"""A leaderboard as JSON: the same tables for programs; rates from 0 to 1."""

from __future__ import annotations

import json

import msgspec

from prbench.leaderboard.tables import DatasetTable, Leaderboard, MacroTable, TableRow, hides
from prbench.metrics import METRICS

SCHEMA_VERSION = 1


def as_json(leaderboard: Leaderboard) -> str:
    """Sorted keys, two-space indent."""
    value = {
        "schema_version": SCHEMA_VERSION,
        "tables": [_table(table) for table in leaderboard.tables],
        "macro_means": [_macro(macro) for macro in leaderboard.macro],
        "notes": list(leaderboard.notes),
    }
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def _table(table: DatasetTable) -> dict[str, object]:
    protocol, identity, content, split, chosen = table.key
    return {
        "dataset": table.dataset,
        "title": table.title,
        "synthetic": table.synthetic,
        "redistribution": table.redistribution,
        "protocol_digest": protocol,
        "identity_digest": identity,
        "content_digest": content,
        "split": split,
        "selection_digest": chosen,
        "sequences": table.sequences,
        "recordings": table.recordings,
        "rows": [_row(row) for row in table.rows],
    }


def _row(row: TableRow) -> dict[str, object]:
    entry = row.entry
    return {
        "run": entry.run,
        "method": entry.method,
        "kind": entry.record.method.kind,
        "version": entry.record.method.version,
        "weights_digest": entry.record.method.weights_digest,
        "condition": entry.record.condition,
        "control": entry.record.control,
        "variant": row.variant,
        "seed": entry.record.seed,
        "samples": entry.record.samples,
        "scored": entry.scored,
        "verified": not entry.unverified,
        "why_unverified": entry.unverified,
        "unsupported": entry.summary.unsupported,
        "ranks": row.ranks,
        "metrics": msgspec.to_builtins(entry.summary.metrics),
        "says_nothing": [info.id for info in METRICS if hides(entry, info)],
    }


def _macro(macro: MacroTable) -> dict[str, object]:
    return {
        "datasets": list(macro.datasets),
        "synthetic": macro.synthetic,
        "rows": [
            {
                "method": row.method,
                "condition": row.condition,
                "variant": row.variant,
                "means": row.means,
                "ranks": row.ranks,
                "verified": not row.unverified,
                "missing": list(row.missing),
            }
            for row in macro.rows
        ],
    }
