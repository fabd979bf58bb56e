"""Available memory of the process, compared with a raster's needs before reading."""

from __future__ import annotations

import math
import os
import pathlib

SMALL = 2**28  # bytes; smaller needs are not checked
_CGROUP = pathlib.Path("/sys/fs/cgroup")


def check_fits(need: int, error: type[ValueError], what: str, advice: str) -> None:
    """Raise `error` if `need` bytes exceed the available memory; `what` begins the message, `advice` ends it."""
    if need < SMALL:
        return
    free = memory_at_hand()
    if need > free:
        raise error(f"{what} need about {gigabytes(need)} of memory, and {gigabytes(free)} are at hand. {advice}")


def memory_at_hand() -> float:
    """Bytes available without swapping, by machine, container and process; infinite if unknown."""
    return max(0.0, min(_of_machine(), _of_container(), _of_process()))


def gigabytes(count: float | int) -> str:
    """A number of bytes in GB, for a message."""
    return f"{count / 1e9:.2g} GB" if count < 1e10 else f"{count / 1e9:,.0f} GB"


def _of_machine() -> float:
    """Available memory by Linux; elsewhere all memory, if the system reports it."""
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            return 1024.0 * float(line.split()[1])
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf
        return math.inf


def _of_container() -> float:
    """Memory left by the control group and its parents; its page cache can be reclaimed."""
    least = math.inf
    for line in _lines("/proc/self/cgroup"):
        number, kinds, path = [*line.split(":", 2), "", ""][:3]
        if kinds == "" and number == "0":
            root, limit, used, inactive = _CGROUP, "memory.max", "memory.current", "inactive_file"
        elif "memory" in kinds.split(","):
            root, limit, used = _CGROUP / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
            inactive = "total_inactive_file"
        else:
            continue
        folder = root / path.strip("/")
        for one in (folder, *folder.parents):
            if one != root and root not in one.parents:
                break
            taken = _number(one / used) - _number(one / "memory.stat", inactive)
            least = min(least, _number(one / limit, default=math.inf) - taken)
    return least


def _of_process() -> float:
    """Memory left by a limit of the process's address space (`ulimit -v`)."""
    try:
        import resource
    except ImportError:  # Windows
        return math.inf
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if most == resource.RLIM_INFINITY:
        return math.inf
    pages = next(iter(_lines("/proc/self/statm")), "0").split()[0]
    return float(most) - float(pages) * resource.getpagesize()


def _number(path: pathlib.Path, key: str = "", default: float = 0.0) -> float:
    """The number in a system file, or the one after a key; `default` if there is none."""
    for line in _lines(path):
        words = line.split()
        if (words and not key) or words[:1] == [key]:
            return float(words[-1]) if words[-1].isdecimal() else default
    return default


def _lines(path: str | pathlib.Path) -> list[str]:
    try:
        return pathlib.Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
