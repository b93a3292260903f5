"""The structure as the documentation shows it, from the imports."""

from __future__ import annotations

from pathlib import Path

from tests.loading import module_at

rooms = module_at(Path(__file__).resolve().parents[2] / "docs" / "rooms.py")


def test_every_room_says_what_it_is_and_stands_above_what_it_imports():
    below = rooms.arrows()
    floor = rooms.floors(below)
    assert all(floor[room] > floor[each] for room, others in below.items() for each in others)
    rows = [line.split("|") for line in rooms.table().splitlines()[2:]]
    assert {row[1].strip(" `") for row in rows} == set(below)
    assert [row[1] for row in rows if not row[4].strip()] == []


def test_arrows_that_others_imply_are_left_out():
    below = rooms.arrows()
    drawn = rooms.needed(below)
    assert sum(map(len, drawn.values())) < sum(map(len, below.values()))

    def reached(room: str) -> set[str]:
        return set(drawn[room]).union(*(reached(each) for each in drawn[room]))

    assert all(below[room] <= reached(room) for room in below)


def test_the_picture_is_the_same_when_drawn_again(tmp_path: Path):
    texts = []
    for name in ("a.svg", "b.svg"):
        rooms.draw(tmp_path / name)
        texts.append((tmp_path / name).read_text(encoding="utf-8"))
    assert texts[0] == texts[1]
    assert all(f">{room}<" in texts[0] for room in ("diagnosis", "fitting", "site_model", "model"))
