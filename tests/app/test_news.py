"""One way by which pages learn of what is new: pushed, and a part is drawn where it shows it."""

from __future__ import annotations

import asyncio
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from loopcal.app.refits import News
from loopcal.app.session import Session
from tests.app.plain_command import command

pytest.importorskip("tomlkit", reason="tomlkit is absent; `pip install .[app]` installs it")


def told(session: Session, found: Callable[[], bool]) -> bool:
    """Wait for news until something is so."""
    new = threading.Event()
    end = session.news.subscribe(new.set)
    for _ in range(100):
        if found():
            break
        new.wait(5.0)
        new.clear()
    end()
    return found()


def test_whoever_subscribed_is_told_and_nobody_else() -> None:
    news, heard = News(), []
    ends = [news.subscribe(lambda name=name: heard.append(name)) for name in "ab"]  # type: ignore[misc]
    news.tell()
    ends[0]()
    news.tell()
    assert heard == ["a", "b", "b"]


def test_much_at_a_time_counts_once_and_a_page_that_goes_ends_its_subscription() -> None:
    news = News()

    async def page() -> int:
        count, each = 0, news.each()
        await anext(each)  # what was there before
        for _ in range(50):
            news.tell()
        async for _ in each:
            count += 1
            if count == 1:
                news.tell()
            else:
                break
        await each.aclose()
        return count

    with ThreadPoolExecutor(1) as aside:  # a browser of other tests has the loop of this thread
        assert aside.submit(lambda: asyncio.run(page())).result() == 2
    assert news._heard == ()


def test_a_change_by_another_program_is_told(tmp_path: Path) -> None:
    session = Session(tmp_path, command)
    session.watch()
    before = session.version
    (tmp_path / "new.csv").write_text("a,b\n1,2\n")
    assert told(session, lambda: session.version != before)


def test_the_process_of_a_fit_stays_for_the_next_and_its_end_is_told(
    hostile: Path, tmp_path: Path
) -> None:
    shutil.copytree(hostile, tmp_path / "arm")
    session = Session(tmp_path / "arm", command)
    source = session.source()
    assert source is not None
    poses = source.table.poses

    def ended() -> bool:
        return not session.refits.going

    session.excluded(poses[:2], "bad reading")
    assert told(session, ended)
    first, process = session.shown(), session.refits.process
    assert first is not None
    assert first.table.poses == poses[2:]
    assert process is not None
    session.excluded(poses[2:4], "bad reading")
    assert session.shown() is first or ended()  # what was shown stays until the fit has ended
    assert told(session, ended)
    second = session.shown()
    assert second is not None
    assert second.table.poses == poses[4:]
    assert session.refits.process is process
    session.folder.undo()
    session.folder.undo()
    assert session.shown() is source  # the result is of this project again
    process.kill()
    assert told(session, lambda: session.refits.process is None)
    session.excluded(poses[:3], "bad reading")
    assert told(session, ended)
    third = session.shown()
    assert third is not None
    assert third.table.poses == poses[3:]
