"""Output files: whole or not there, kept as they were but for their contents, never in the way."""

import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hframe_post.errors import HframeError
from hframe_post.writers import temporary
from hframe_post.writers.outputs import Outputs
from hframe_post.writers.temporary import give_up, undisturbed

ROOT = os.geteuid() == 0
only_root = pytest.mark.skipif(not ROOT, reason="only root gives files away")


def write(path: Path, text: bytes = b"new", **more: Path) -> None:
    with Outputs() as outputs:
        outputs.open(path, **more).write(text)


@pytest.fixture
def target(tmp_path: Path) -> Path:
    path = tmp_path / "out.gcode"
    path.write_bytes(b"old")
    return path


@pytest.fixture(autouse=True)
def nothing_is_left(tmp_path: Path) -> Iterator[None]:
    yield
    assert not list(tmp_path.rglob(".hframe-post-*"))
    assert not temporary._unfinished


def test_failure_leaves_what_was_there(target: Path) -> None:
    with pytest.raises(RuntimeError), Outputs() as outputs:  # noqa: PT012
        outputs.open(target).write(b"new")
        outputs.open(target.with_name("other")).write(b"new")
        raise RuntimeError
    assert target.read_bytes() == b"old"
    assert list(target.parent.iterdir()) == [target]


def test_files_of_one_command_appear_together(target: Path) -> None:
    other = target.with_name("other")
    with Outputs() as outputs:
        outputs.open(target).write(b"1")
        outputs.open(other).write(b"2")
        assert (target.read_bytes(), other.exists()) == (b"old", False)
    assert (target.read_bytes(), other.read_bytes()) == (b"1", b"2")


def test_a_full_device_keeps_the_files_from_appearing(target: Path) -> None:
    with pytest.raises(OSError, match="No space left"), Outputs() as outputs:  # noqa: PT012
        outputs.open(target).write(b"new")
        outputs.open(Path("/dev/full")).write(b"new")
    assert target.read_bytes() == b"old"
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


@pytest.mark.parametrize("mode", [0o640, 0o600, 0o777])
def test_replaced_file_keeps_its_permissions(target: Path, mode: int) -> None:
    target.chmod(mode)
    write(target)
    assert stat.S_IMODE(target.stat().st_mode) == mode


def test_a_new_file_has_the_usual_permissions(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        write(tmp_path / "new")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640


@only_root
def test_replaced_file_keeps_its_owner(target: Path) -> None:
    os.chown(target, 1234, 2345)
    target.chmod(0o4644)
    write(target)
    status = target.stat()
    assert (status.st_uid, status.st_gid, stat.S_IMODE(status.st_mode)) == (1234, 2345, 0o644)


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "dangling").symlink_to("later")
    for name, real in (("link", "real"), ("dangling", "later")):
        write(tmp_path / name)
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / real).read_bytes() == b"new"


def test_one_of_several_names_is_not_replaced(target: Path) -> None:
    os.link(target, target.with_name("other"))
    with pytest.raises(HframeError, match="2 names"):
        write(target)
    assert target.samefile(target.with_name("other"))


def test_a_write_protected_file_is_not_replaced(target: Path) -> None:
    target.chmod(0o444)
    with pytest.raises(PermissionError, match="write-protected"):
        write(target)
    assert target.read_bytes() == b"old"


def test_what_is_read_is_not_overwritten(target: Path) -> None:
    again = target.with_name("again")
    again.symlink_to(target)
    for path in (target, again, target.parent / "." / target.name):
        with (
            pytest.raises(HframeError, match="already read or written"),
            Outputs([target]) as outputs,
        ):
            outputs.open(path)
    with Outputs([target]) as outputs:
        outputs.open(again, instead_of=target).write(b"new")
    assert target.read_bytes() == b"new"


def test_two_outputs_cannot_be_one_file(tmp_path: Path) -> None:
    new = tmp_path / "new"
    with pytest.raises(HframeError, match="already read or written"), Outputs() as outputs:  # noqa: PT012
        outputs.open(new)
        outputs.open(tmp_path / "." / "new")
    assert not new.exists()


def test_a_source_that_changes_meanwhile_is_noticed(target: Path) -> None:
    def appended() -> None:
        with target.open("ab") as file:
            file.write(b"more")

    def replaced() -> None:
        target.with_name("newer").write_bytes(b"old")
        target.with_name("newer").replace(target)

    for change in (appended, replaced):
        with pytest.raises(HframeError, match="was changed"), Outputs() as outputs:  # noqa: PT012
            outputs.watch(target)
            outputs.open(target).write(b"new")
            change()
        assert target.read_bytes().startswith(b"old")


def test_devices_stay_devices() -> None:
    before = os.stat(os.devnull)
    write(Path(os.devnull))
    after = os.stat(os.devnull)
    assert stat.S_ISCHR(after.st_mode)
    assert after.st_ino == before.st_ino


def test_a_pipe_is_written_through(tmp_path: Path) -> None:
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write(pipe, b"x" * 200_000)
    reader.join(10.0)
    assert got == [b"x" * 200_000]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_an_open_file_goes_on_where_it_is(tmp_path: Path) -> None:
    with (tmp_path / "shared").open("wb", buffering=0) as shared:
        shared.write(b"before ")
        link = tmp_path / "link"
        link.symlink_to(f"/dev/fd/{shared.fileno()}")
        write(Path(f"/dev/fd/{shared.fileno()}"), b"this ")
        write(link, b"and this ")
        shared.write(b"after")
    assert (tmp_path / "shared").read_bytes() == b"before this and this after"


def test_a_stale_file_is_removed_and_one_in_use_is_not(tmp_path: Path) -> None:
    stale = tmp_path / ".hframe-post-0123456789abcdef.tmp"
    strange = tmp_path / ".hframe-post-mine.tmp"
    with Outputs() as slow:
        slow.open(tmp_path / "slow").write(b"slow")
        [busy] = tmp_path.glob(".hframe-post-*")
        stale.write_bytes(b"stale")
        strange.write_bytes(b"not of ours")
        write(tmp_path / "fast")
        assert set(tmp_path.glob(".hframe-post-*")) == {busy, strange}
    assert (tmp_path / "slow").read_bytes() == b"slow"
    strange.unlink()


def test_a_link_under_a_stale_name_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    link = tmp_path / ".hframe-post-0123456789abcdef.tmp"
    link.symlink_to(victim)
    write(tmp_path / "new")
    assert victim.read_bytes() == b"mine"
    link.unlink()


def test_a_signal_handler_can_give_up_at_any_time(target: Path) -> None:
    with pytest.raises(FileNotFoundError), Outputs() as outputs:  # noqa: PT012
        outputs.open(target).write(b"new")
        assert give_up()
        assert list(target.parent.iterdir()) == [target]
    assert target.read_bytes() == b"old"
    with undisturbed():
        assert not give_up()
