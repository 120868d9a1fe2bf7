"""Run as a program: `python3 -I -S helm_sandbox.py SECONDS MEMORY_BYTES FILE_BYTES PROGRAM ARGUMENT...`

Becomes PROGRAM with bounds that it cannot lift: processor time, memory, size of what it writes, no sockets. A chart
that is not trusted yet may name addresses in its schema, which helm would ask; so sockets are taken away by a filter of
the kernel (seccomp), for which no privilege is needed.
"""

from __future__ import annotations

import ctypes
import os
import platform
import resource
import struct
import sys

OPEN_FILES_MAX = 128
NOT_STARTED = 126  # exit code when the program could not be confined or started
PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 38, 22, 2
LOAD_WORD, JUMP_EQUAL, JUMP_GREATER_EQUAL, RETURN = 0x20, 0x15, 0x35, 0x06
ALLOW = 0x7FFF0000
REFUSE = 0x00050000 | 1  # EPERM
NUMBER_OFFSET, ARCHITECTURE_OFFSET = 0, 4
IO_URING_SETUP = 425  # makes sockets as well
FOREIGN_NUMBERS = 0x40000000  # x32 on x86_64
ARCHITECTURES = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}  # AUDIT_ARCH_..., number of socket


def instructions(architecture: int, socket_number: int) -> list[tuple[int, int, int, int]]:
    """(code, jump if true, jump if false, value): refuse socket and io_uring_setup, and every foreign calling form."""
    return [
        (LOAD_WORD, 0, 0, ARCHITECTURE_OFFSET),
        (JUMP_EQUAL, 0, 4, architecture),
        (LOAD_WORD, 0, 0, NUMBER_OFFSET),
        (JUMP_EQUAL, 2, 0, socket_number),
        (JUMP_EQUAL, 1, 0, IO_URING_SETUP),
        (JUMP_GREATER_EQUAL, 0, 1, FOREIGN_NUMBERS),
        (RETURN, 0, 0, REFUSE),
        (RETURN, 0, 0, ALLOW),
    ]


def refuse_sockets() -> None:
    """Keep this process, and what it becomes, from making sockets; OSError when the kernel refuses the filter."""
    architecture = ARCHITECTURES.get(platform.machine())
    if architecture is None:
        raise OSError(f"no filter for machine {platform.machine()}; known are {', '.join(ARCHITECTURES)}")
    program = b"".join(struct.pack("=HBBI", *line) for line in instructions(*architecture))
    lines = ctypes.create_string_buffer(program, len(program))

    class Filter(ctypes.Structure):
        _fields_ = (("length", ctypes.c_ushort), ("lines", ctypes.c_void_p))

    filtering = Filter(len(program) // 8, ctypes.cast(lines, ctypes.c_void_p))
    libc = ctypes.CDLL(None, use_errno=True)
    for arguments in (
        (PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0),
        (PR_SET_SECCOMP, SECCOMP_MODE_FILTER, ctypes.byref(filtering)),
    ):
        if libc.prctl(*arguments) != 0:
            raise OSError(ctypes.get_errno(), "prctl refused the filter")


def bound(kind: int, value: int) -> None:
    """Lower a limit; never above what holds already."""
    _, most = resource.getrlimit(kind)
    value = value if most == resource.RLIM_INFINITY else min(value, most)
    resource.setrlimit(kind, (value, value))


def main() -> None:
    """Bound this process and become the program."""
    seconds, memory_bytes, file_bytes = (int(word) for word in sys.argv[1:4])
    bound(resource.RLIMIT_CPU, seconds)
    bound(resource.RLIMIT_DATA, memory_bytes)
    bound(resource.RLIMIT_FSIZE, file_bytes)
    bound(resource.RLIMIT_NOFILE, OPEN_FILES_MAX)
    bound(resource.RLIMIT_CORE, 0)
    try:
        refuse_sockets()
        os.execve(sys.argv[4], sys.argv[4:], dict(os.environ))  # noqa: S606 - the caller names the program by its path
    except OSError as error:
        sys.stderr.write(f"{sys.argv[4]} cannot be started: {error}\n")
        sys.exit(NOT_STARTED)


if __name__ == "__main__":
    main()
