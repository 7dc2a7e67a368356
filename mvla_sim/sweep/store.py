"""Where finished cases are kept: one SQLite file in the experiment's folder, that one run at a time may write."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from mvla_sim.engine.machine import program_version
from mvla_sim.engine.provenance import code_digest
from mvla_sim.errors import DataError, MvlaError, OutputError
from mvla_sim.files import locked_folder
from mvla_sim.sweep.axes import dotted_key
from mvla_sim.sweep.case import ROW_SCHEMA, Row, flatten
from mvla_sim.sweep.plan import Plan

__all__ = ["FILE", "Store", "identity"]

FILE: Final = "store.sqlite"
COMMIT_S: Final = 0.5
"""Finished cases are committed together at most this often; a killed run loses no more than that."""

TABLES: Final = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE cases (key TEXT PRIMARY KEY, status TEXT NOT NULL, error TEXT NOT NULL, seconds REAL NOT NULL,
                    metrics TEXT NOT NULL) WITHOUT ROWID;
"""

NUMERIC: Final = ("constants", "streams", "dsp", "grid", "scene", "channel", "imaging", "evaluation")
"""Parts of the package that decide a case's numbers."""

Identity = dict[str, dict[str, Any]]


def identity(plan: Plan) -> Identity:
    """Everything that must stay the same for two runs to share a store: all settings but the values of the axes.

    Returns the flat settings under ``experiment``, and those of each scene under ``scene NAME``. Settings that an axis
    or a design replaces are left out, so values may be added to an axis, samples to a design, and scenes to the
    experiment.
    """
    experiment = plan.experiment
    drawn = experiment.design.keys if experiment.design is not None else ()
    replaced = tuple(dotted_key(axis) or axis for axis in (*experiment.axes, *drawn))

    def flat(data: dict[str, Any]) -> dict[str, Any]:
        pairs = flatten(data, longest=10**9)
        return {key: value for key, value in pairs if not _under(key, replaced)}

    blocks = experiment.model_dump(mode="json", include={"imaging", "evaluation", "calibration"}, by_alias=True)
    common = flat(blocks) | {"axes": ", ".join(sorted(experiment.axes))}
    scenes = {name: scene.model_dump(mode="json", exclude={"description"}) for name, scene in plan.files.items()}
    files = {f"channel {source.name}": {"key": source.key} for source in plan.sources.values() if source.scene is None}
    return {"experiment": common} | files | {f"scene {name}": flat({"scene": data}) for name, data in scenes.items()}


class Store:
    """The finished cases of one experiment.

    Use :meth:`open` as a context manager: it holds the folder's lock for as long as the process lives, so a lock can
    not be left behind.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.notes: list[str] = []
        self._last = time.monotonic()
        with self._explained():
            self._database = sqlite3.connect(file, timeout=5, isolation_level=None)

    @classmethod
    @contextlib.contextmanager
    def open(cls, folder: Path, wanted: Identity, *, fresh: bool = False) -> Iterator[Store]:
        """Lock a folder and open the store in it, made if it is not there; ``fresh``: delete what is stored before.

        Raises
        ------
        OutputError
            Another run holds the folder, or it cannot be written.
        DataError
            The store is damaged, of another schema or version, or of an experiment with other settings; the message
            says what differs.
        """
        with locked_folder(folder, "run"):
            file = folder / FILE
            if fresh:
                for name in (FILE, f"{FILE}-journal"):
                    (folder / name).unlink(missing_ok=True)
            store = cls(file)
            try:
                store._prepare(wanted)
                yield store
                store.flush()
            finally:
                store._close()

    @classmethod
    def peek(cls, folder: Path, wanted: Identity) -> dict[str, Row]:
        """What a folder's store holds, without locking it; nothing where there is none. Errors as :meth:`open`."""
        file = folder / FILE
        if not file.exists() or file.stat().st_size == 0:
            return {}
        store = cls(file)
        try:
            return {} if store._check(wanted) is None else store.rows()
        finally:
            store._close()

    def rows(self) -> dict[str, Row]:
        """Everything stored, by key."""
        with self._explained():
            found = self._database.execute("SELECT key, status, error, seconds, metrics FROM cases").fetchall()
        try:
            return {row[0]: Row(row[0], row[1], row[2], row[3], _metrics(row[4])) for row in found}
        except ValueError as error:
            raise self._unusable(f"a stored case cannot be read ({error})") from error

    def add(self, row: Row) -> None:
        """Keep a case in place of what is stored under its key; on disk within half a second.

        Raises OutputError where the disk is full or the file cannot be written; what was stored before stays.
        """
        values = (row.key, row.status, row.error, row.seconds, json.dumps(dict(row.metrics)))
        with self._explained():
            if not self._database.in_transaction:
                self._database.execute("BEGIN")
            self._database.execute("INSERT OR REPLACE INTO cases VALUES (?, ?, ?, ?, ?)", values)
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Commit if the last commit is half a second ago. Raises as :meth:`add`."""
        if time.monotonic() - self._last >= COMMIT_S:
            self.flush()

    def flush(self) -> None:
        """Commit. Raises as :meth:`add`."""
        with self._explained():
            if self._database.in_transaction:
                self._database.execute("COMMIT")
        self._last = time.monotonic()

    def _prepare(self, wanted: Identity) -> None:
        known = self._check(wanted)
        with self._explained():
            self._database.execute("PRAGMA synchronous = NORMAL")
            self._database.execute("BEGIN")
            if known is None:
                for statement in TABLES.split(";")[:-1]:
                    self._database.execute(statement)
            found = self._database.execute("SELECT value FROM meta WHERE name = 'codes'").fetchone()
            codes = json.loads(found[0]) if found else []  # digests of the code that computed what is stored
            current = code_digest(*NUMERIC)
            if any(code != current for code in codes):
                self.notes.append(
                    f"{self.file}: some cases stored here were computed before this program's code was changed; "
                    f"a fresh run computes them anew"
                )
            values = {
                "schema": ROW_SCHEMA,
                "program": program_version(),
                "codes": sorted({*codes, current}),
                "identity": (known or {}) | wanted,
            }
            self._database.executemany(
                "INSERT OR REPLACE INTO meta VALUES (?, ?)",
                [(name, json.dumps(value, sort_keys=True)) for name, value in values.items()],
            )
            self._database.execute("COMMIT")

    def _check(self, wanted: Identity) -> Identity | None:
        """Identity of what is stored, None where nothing is; refuses what does not fit."""
        with self._explained():
            if self._database.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
                raise self._unusable("the store is damaged")
            tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not tables:
                return None
            if tables != {"meta", "cases"}:
                raise self._unusable("is a database, but no store of a sweep")
            meta = dict(self._database.execute("SELECT name, value FROM meta").fetchall())
        try:
            schema, program, known = (json.loads(meta[name]) for name in ("schema", "program", "identity"))
        except (KeyError, ValueError) as error:
            raise self._unusable(f"the store's description cannot be read ({error!r})") from error
        if schema != ROW_SCHEMA:
            raise self._unusable(f"schema {schema}; this program writes schema {ROW_SCHEMA}")
        if program != program_version():
            raise self._unusable(f"made by mvla-sim {program}, this is {program_version()}")
        differences = list(_differences(known, wanted))
        if differences:
            raise self._unusable(f"holds cases of other settings: {'; '.join(differences)}")
        stored: Identity = known
        return stored

    def _close(self) -> None:
        """Keep what is not committed yet, if that is possible."""
        with contextlib.suppress(MvlaError):
            self.flush()
        with contextlib.suppress(sqlite3.Error):
            self._database.close()

    def _unusable(self, why: str) -> DataError:
        advice = "choose another folder, or discard what is stored with a fresh run"
        return DataError(f"{self.file}: {why}; {advice}", setting="fresh")

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """Turn SQLite's errors into one line."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            text = str(error)
            if "full" in text:
                raise OutputError(
                    f"{self.file}: no space left on the disk ({text}); what was stored stays: make room and run again"
                ) from error
            if isinstance(error, sqlite3.OperationalError) and "malformed" not in text:
                raise OutputError(f"{self.file}: cannot be used ({text})") from error
            raise self._unusable(f"not a readable store, truncated or damaged ({text})") from error


def _metrics(text: str) -> dict[str, Any]:
    """Metrics of a row; rows by the ten thousand share their names."""
    return {sys.intern(name): value for name, value in json.loads(text).items()}


def _under(key: str, replaced: tuple[str, ...]) -> bool:
    return any(key == axis or key.startswith(f"{axis}.") for axis in replaced)


def _differences(known: Identity, wanted: Identity) -> Iterator[str]:
    """What differs, as "key = there there, here here"; parts that only one of them has are additions."""
    for part in known.keys() & wanted.keys():
        prefix = "" if part == "experiment" else f"{part}: "
        for key in sorted(known[part].keys() | wanted[part].keys()):
            there, here = (_shown(side[part], key) for side in (known, wanted))
            if there != here:
                yield f"{prefix}{key.removeprefix('scene.')} = {there} there, {here} here"


def _shown(settings: Mapping[str, Any], key: str) -> str:
    return json.dumps(settings[key], ensure_ascii=False) if key in settings else "absent"
