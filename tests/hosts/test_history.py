"""The history of a printer: complete lines count, and it does not grow forever."""

from __future__ import annotations

from pathlib import Path

from hframe_post.hosts.moonraker.disk import HISTORY_BYTES, Event, add, events


def test_a_broken_line_costs_only_itself(tmp_path: Path) -> None:
    folder = tmp_path / "history"
    known = [Event("check", 1e9 + k, {"x": (43.0, 42.0)}) for k in range(3)]
    add(folder, known[0])
    with (folder / "history.jsonl").open("ab") as file:
        file.write(
            b'[]\n{"kind": "check", "at": NaN}\n{"kind": "check", "at": 1e999}\n{"kind": "ch'
        )
    add(folder, known[1])
    add(folder, known[2])
    assert [*events(folder)] == known


def test_it_stays_bounded_and_loses_the_oldest(tmp_path: Path) -> None:
    (tmp_path / "history.before.jsonl").write_bytes(b'{"kind": "check", "at": 1}\n')
    kept = b'{"kind": "check", "at": 2}\n'
    (tmp_path / "history.jsonl").write_bytes(kept * (HISTORY_BYTES // len(kept) + 1))
    add(tmp_path, Event("check", 3.0))
    found = [event.at for event in events(tmp_path)]
    assert set(found) == {2.0, 3.0}
    assert found[-1] == 3.0
