"""Two folders change places: what is made beside a folder takes its place by one rename, under a lock.

`renameat2(2)` exchanges two names at once on Linux; where a file system cannot, the old folder is renamed away first,
and a writer that finds it so puts it back.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from calibration_core.errors import InputError
from calibration_core.files.regular import read_regular

NEW, OLD, LIST = ".new", ".old", ".carried"
PATIENCE = 60.0  # s, waiting for another writer to finish its renames
MAX_LIST = 1 << 24
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_CANNOT = {errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.ENOTTY}


class SwapPlace:
    """The place of one folder while something new is made for it.

    A context manager: what was made but not committed is gone at the end.

    Attributes:
        target: The folder.
        new: Where its new content is to be made.
    """

    def __init__(self, target: Path) -> None:
        """Remember the folder, which must exist."""
        self.target = target
        self.new = target
        self._inside = not _can_change_places(target)
        self._lock = -1

    def __enter__(self) -> Self:
        """Clear what killed writers left, and make the folder for the new content."""
        with _locked(self._home):
            self._clear()
            self.new = Path(tempfile.mkdtemp(prefix=self._prefix, suffix=NEW, dir=self._home))
            self._lock = os.open(self.new, os.O_RDONLY | os.O_CLOEXEC)
            fcntl.flock(self._lock, fcntl.LOCK_EX)  # tells other writers that this one lives
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove what is left over."""
        for path in (self.new, self.new.with_suffix(OLD)):
            shutil.rmtree(path, ignore_errors=True)
        self.new.with_suffix(LIST).unlink(missing_ok=True)
        os.close(self._lock)

    def commit(self, kept: Callable[[], Collection[str]]) -> None:
        """Put the new content in the folder's place.

        Args:
            kept: Tells, under the lock, which names of the old folder stay.

        Raises:
            OSError: It cannot be done; the old folder is as it was.
        """
        with _locked(self._home):
            if self._inside:
                self._one_by_one(kept())
            else:
                self._exchange(kept())
            _sync(self._home)

    @property
    def _home(self) -> Path:
        return self.target if self._inside else self.target.parent

    @property
    def _prefix(self) -> str:
        return f".{self.target.name[:100]}."

    def _exchange(self, kept: Collection[str]) -> None:
        listed = self.new.with_suffix(LIST)
        if kept:
            listed.write_text(json.dumps(sorted(kept)), encoding="utf-8")
        self.new.chmod(self.target.stat().st_mode & 0o7777)
        try:
            _change_places(self.new, self.target)
        except OSError as error:
            if error.errno not in _CANNOT:
                raise
            old = self.new.with_suffix(OLD)
            self.target.rename(old)
            self.new.rename(self.target)
            old.rename(self.new)
        _carry(kept, self.new, self.target)
        listed.unlink(missing_ok=True)

    def _one_by_one(self, kept: Collection[str]) -> None:
        stays = {*kept, self.new.name}
        saved = Path(tempfile.mkdtemp(dir=self.new))
        made = sorted((path for path in self.new.iterdir() if path != saved), key=_result_last)
        gone = sorted((path for path in self.target.iterdir() if path.name not in stays), key=_result_last)
        moved: list[tuple[Path, Path]] = []
        try:
            for source, goal in [
                *((path, saved / path.name) for path in reversed(gone)),
                *((path, self.target / path.name) for path in made),
            ]:
                source.rename(goal)
                moved.append((source, goal))
        except BaseException:
            for source, goal in reversed(moved):
                goal.rename(source)
            raise

    def _clear(self) -> None:
        """Put in order what writers left that did not live to do it themselves."""
        prefix = self._prefix
        with os.scandir(self._home) as entries:
            left = [self._home / entry.name for entry in entries if entry.name.startswith(prefix)]
        for old in (path for path in left if path.name.endswith(OLD)):
            if not self._inside and not any(self.target.iterdir()):  # an empty folder may be renamed over
                old.rename(self.target)
        for new in (path for path in left if path.name.endswith(NEW)):
            with _abandoned(new) as is_abandoned:
                if not is_abandoned:
                    continue
                listed = new.with_suffix(LIST)
                with contextlib.suppress(InputError, ValueError):
                    names = json.loads(read_regular(listed, MAX_LIST, "list"))
                    _carry([str(name) for name in names], new, self.target)
                shutil.rmtree(new, ignore_errors=True)
                shutil.rmtree(new.with_suffix(OLD), ignore_errors=True)
                listed.unlink(missing_ok=True)


def _can_change_places(target: Path) -> bool:
    try:
        inside = Path.cwd().is_relative_to(target)
    except OSError:  # the working directory is gone
        inside = False
    return not (inside or target.is_mount() or not os.access(target.parent, os.W_OK | os.X_OK))


def _change_places(one: Path, other: Path) -> None:
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS)) from None
    if rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(other))


def _carry(names: Collection[str], source: Path, target: Path) -> None:
    """Move what stays; what stands in the target already is newer."""
    for name in names:
        one, other = source / Path(name).name, target / Path(name).name
        if os.path.lexists(one) and not os.path.lexists(other):
            one.rename(other)


@contextlib.contextmanager
def _locked(directory: Path) -> Iterator[None]:
    handle = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        begin = time.monotonic()
        while not _try_lock(handle):
            if time.monotonic() - begin > PATIENCE:
                raise OSError(errno.EBUSY, "locked by another process", str(directory))
            time.sleep(0.01)
        yield
    finally:
        os.close(handle)


def _try_lock(handle: int) -> bool:
    """Take the lock; a file system without locks gives it to everybody."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EWOULDBLOCK, errno.EACCES)
    return True


@contextlib.contextmanager
def _abandoned(directory: Path) -> Iterator[bool]:
    """Tell whether the writer of a folder is gone."""
    try:
        handle = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        yield False
        return
    try:
        yield _try_lock(handle)
    finally:
        os.close(handle)


def _result_last(path: Path) -> tuple[bool, str]:
    return path.name == "result.json", path.name


def _sync(directory: Path) -> None:
    handle = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
            raise
    finally:
        os.close(handle)
