"""The file under a recording: created beside its final name, made durable, published without overwriting."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.errors import BenchError, DiskFullError, RecordingError, RecordingExistsError

__all__ = ["OutputFile", "active_path", "explain_os_error", "explained", "final_path", "rename_new", "verify_absent"]

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def active_path(path: Path) -> Path:
    """Return the name of a recording while it is being written."""
    return path.with_name(path.name + ".active")


def final_path(path: Path) -> Path:
    """Return the name of a recording when it is finished, of either of its names."""
    return path.with_name(path.name.removesuffix(".active"))


def explain_os_error(error: OSError, path: Path) -> BenchError:
    """Return the sentence that belongs to an error while writing `path`."""
    reason = error.strerror or str(error)
    if error.errno in _FULL:
        return DiskFullError(
            f"The disk cannot take more of {path}: {reason}.", hint="Free some space, or set run.output_dir elsewhere."
        )
    return RecordingError(f"{path} cannot be written: {reason}.", hint="Check the disk and the folder's permissions.")


class OutputFile:
    """A new file ``<path>.active`` that becomes `path` when it is complete.

    Parameters
    ----------
    path : Path
        The final name. Its folder is created if it is missing.

    Raises
    ------
    RecordingExistsError
        `path` or its active name exists; nothing is touched.
    RecordingError
        The folder or the file cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.active = active_path(path)
        self._is_published = False
        with explained(path):
            _make_folder(path)
            verify_absent(path)
            verify_absent(self.active)
            try:
                self.stream = self.active.open("xb")
            except FileExistsError:
                verify_absent(self.active)
                raise

    def sync(self) -> None:
        """Return when everything written is on the disk, under the name it is expected under.

        Raises
        ------
        OSError
            The disk refuses, or the file was moved or deleted while it was being written.
        """
        self.stream.flush()
        os.fdatasync(self.stream.fileno())
        there, here = self.active.stat(), os.fstat(self.stream.fileno())
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            raise FileNotFoundError(errno.ENOENT, "the file was replaced by another", str(self.active))

    def sync_folder(self) -> None:
        """Make the file's name durable: without it, a crash may leave a file that no folder lists."""
        descriptor = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self) -> int:
        """Return what the disk can still take, wherever the folder has gone meanwhile.

        Raises
        ------
        RecordingError
            The disk is gone.
        """
        with explained(self.active):
            status = os.fstatvfs(self.stream.fileno())
        return status.f_bavail * status.f_frsize

    def close(self) -> None:
        """Close without publishing: what is readable stays under the active name."""
        with suppress(OSError):  # a full disk refuses the last bytes once more
            self.stream.close()

    def discard(self) -> None:
        """Close and delete: for a recording that never began."""
        self.close()
        with suppress(OSError):
            (self.path if self._is_published else self.active).unlink()

    def publish(self) -> None:
        """Give the synced file its final name.

        Raises
        ------
        RecordingExistsError
            The final name was taken meanwhile; the recording keeps its active name.
        OSError
            The folder does not take the new name.
        """
        self.stream.close()
        try:
            rename_new(self.active, self.path)
        except FileExistsError as error:
            raise _taken(self.path, f"The recording is complete in {self.active}.") from error
        self._is_published = True
        self.sync_folder()


def rename_new(source: Path, target: Path) -> None:
    """Rename a file without ever replacing another, as `os.rename` would; `FileExistsError` if the name is taken."""
    try:
        os.link(source, target)
    except OSError as error:
        if error.errno not in {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}:
            raise
        # file systems without hard links (exFAT, some network shares): take the name first, then replace it
        target.open("xb").close()
        source.replace(target)
    else:
        source.unlink()


def _make_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise RecordingError(
            f"{path} cannot be written: {path.parent} is, or lies under, a file.", hint="Choose another --output."
        ) from error


def verify_absent(path: Path, why: str = "") -> None:
    """Raise `RecordingExistsError` if there is anything called `path`."""
    if os.path.lexists(path):
        unfinished = path.name.endswith(".active")
        before = (
            "It is being written, or was left by a run that broke off; it can be read as it is. " if unfinished else ""
        )
        raise _taken(path, f"{before}{why}Choose another --output, or move the old file away.")


def _taken(path: Path, hint: str) -> RecordingExistsError:
    return RecordingExistsError(f"{path} exists already and is not overwritten.", hint=hint)


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Raise what the system says about a file as an error of ours."""
    try:
        yield
    except OSError as error:
        raise explain_os_error(error, path) from error
