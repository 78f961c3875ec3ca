# SPDX-License-Identifier: Apache-2.0
"""Damage to files, drawn from a random generator: of their bytes, their text, their structure, and in their folder."""

from __future__ import annotations

import gzip
import io
import json
import os
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

INTEGERS = (0, 1, -1, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, -(2**31), 2**32 - 1, 2**40, 2**63 - 1, -(2**63))
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e-308, 1e30, 1e308, -1e308)
WORDS = (
    *("nan", "NaN", "inf", "-inf", "Infinity", "1e999", "-1", "0", "1e308", "1e-308", "9" * 25, "-" + "9" * 400),
    *("", "x", "true", "null", "[]", "{}", '""', "../../x", "1,2", "0x1f", "1_000", "²", "\u202e", "/dev/zero", "\0"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, [], {}, "", "x", "../x", "\0", "\ud800", "x" * 5000, 0, -1, 2**31, 2**63, 10**30, 0.5, [[]], [None]),
    *(float("nan"), float("inf"), -1e308, 1e308, [0.0], [1, 2, 3], {"x": 1}, "nan", "-1"),
)
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
ZEROS = 1 << 26
BOMB_MEMBERS = 64  # of 64 MB each
HEAD = 400  # bytes of a file that are its header, more or less


def flipped(data: bytes, rng: random.Random) -> bytes:
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 4, 32))):
        found[_place(data, rng, 1)] ^= 1 << rng.randrange(8)
    return bytes(found)


def cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))] if rng.random() < 0.7 else data[: _place(data, rng, 1)]


def shuffled(data: bytes, rng: random.Random) -> bytes:
    """A block that is doubled, left out, moved, or filled."""
    start, size = _place(data, rng, 1), rng.choice((1, 4, 8, 64, 1024))
    block, rest = data[start : start + size], data[start + size :]
    other = rng.randrange(len(data))
    return rng.choice(
        (
            data[:start] + block + block + rest,
            data[:start] + rest,
            data[:start] + data[other : other + size] + rest,
            data[:start] + bytes(len(block)) + rest,
            data[:start] + b"\xff" * len(block) + rest,
            data + block,
        )
    )


def binary_number(data: bytes, rng: random.Random) -> bytes:
    kind = rng.choice("bhiqfd")
    size, order = struct.calcsize(kind), rng.choice("<<<>")
    if len(data) < size:
        return b""
    if kind in "fd":
        value = rng.choice(FLOATS)
        number = struct.pack(order + kind, value if kind == "d" or abs(value) < 1e38 else float("inf"))
    else:
        number = struct.pack(order + "q", rng.choice(INTEGERS))[:size] if order == "<" else b"\x7f" + bytes(size - 1)
    start = _place(data, rng, size)
    return data[:start] + number + data[start + size :]


def written_number(data: bytes, rng: random.Random) -> bytes:
    found = list(NUMBER.finditer(data[:200_000]))
    if not found:
        return flipped(data, rng)
    one = rng.choice(found)
    return data[: one.start()] + rng.choice(WORDS).encode() + data[one.end() :]


def text(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data) + 1)
    lines = data.splitlines(keepends=True)
    rng.shuffle(lines)
    piece = rng.choice(
        (b"\xff\xfe", b"\0", b"\xed\xa0\x80", b'"', b"'", b"[" * 100_000, b"{" * 3000, b"x" * 200_000, b"\r")
    )
    return rng.choice(
        (
            data[:start] + piece + data[start:],
            data[:start] + rng.choice(WORDS).encode() + data[start:],
            b"".join(lines),
            b"".join(lines[: len(lines) // 2] * 3),
            data.decode("latin-1").encode("utf-16"),
            b"\xef\xbb\xbf" + data.replace(b"\n", b"\r\n"),
        )
    )


def changed_json(data: bytes, rng: random.Random) -> bytes:
    """One value of another kind, one key that is missing, or brackets without end."""
    if rng.random() < 0.03:
        return b'{"frames":' + b"[" * 200_000
    content = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 3))):
        content = _changed(content, rng)
    return json.dumps(content).encode("utf-8", "surrogatepass")


def _changed(content: Any, rng: random.Random) -> Any:
    node, depth = content, rng.randrange(9)
    for _ in range(depth):
        if isinstance(node, dict | list) and node:
            inner = node[rng.choice(list(node))] if isinstance(node, dict) else node[rng.randrange(len(node))]
            if not isinstance(inner, dict | list) or not inner:
                break
            node = inner
    if not isinstance(node, dict | list) or not node:
        return rng.choice(VALUES)
    key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
    if rng.random() < 0.2:
        del node[key]
    else:
        node[key] = rng.choice(VALUES)
    return content


def changed_glb(data: bytes, rng: random.Random) -> bytes:
    size = struct.unpack_from("<I", data, 12)[0]
    inner = changed_json(data[20 : 20 + size], rng)
    inner += b" " * (-len(inner) % 4)
    rest = data[20 + size :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(inner) + len(rest), len(inner), b"JSON") + inner + rest


def changed_gzip(data: bytes, rng: random.Random) -> bytes:
    """What is inside is damaged, and packed again; or there is no end of zeros."""
    inner = gzip.decompress(data)
    if rng.random() < 0.05:
        return gzip.compress(inner[:16], mtime=0) + gzip.compress(bytes(ZEROS), 1, mtime=0) * BOMB_MEMBERS
    return gzip.compress(rng.choice((flipped, cut, binary_number))(inner, rng), mtime=0)


def changed_npz(data: bytes, rng: random.Random) -> bytes:
    """One array with another header, damaged, or left out; in a container that is whole, with its checksum."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        names = source.namelist()
        victim = rng.choice(names)
        for name in names:
            content = source.read(name)
            if name == victim:
                kind = rng.randrange(6)
                if kind == 0:
                    continue
                header = rng.choice(
                    (
                        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
                        "{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }",
                        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
                        "{'descr': '<U9', 'fortran_order': False, 'shape': (), }",
                        "{'descr': '<f4', 'fortran_order': False, 'shape': (0, 4), }",
                        "{'descr': '<c8', 'fortran_order': False, 'shape': (2, 2, 2), }",
                        "(" * 5000,
                    )
                ).encode()
                body = content[10 + struct.unpack_from("<H", content, 8)[0] :]
                content = (
                    b"\x93NUMPY\1\0" + struct.pack("<H", len(header) + 1) + header + b"\n" + body
                    if kind < 4
                    else rng.choice((flipped, cut, binary_number))(content, rng)
                )
            target.writestr(name, content)
    return out.getvalue()


def huge_png(data: bytes, rng: random.Random) -> bytes:
    size = struct.pack(
        ">II", *rng.choice(((2**31 - 1, 2**31 - 1), (60_000, 60_000), (12_000, 12_000), (1, 2**20), (0, 0)))
    )
    head = b"IHDR" + size + data[24:29]
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]


Mutation = Callable[[bytes, random.Random], bytes]
BINARY: tuple[Mutation, ...] = (flipped, flipped, cut, shuffled, binary_number, binary_number)
TEXT: tuple[Mutation, ...] = (written_number, written_number, written_number, text, text, cut, shuffled)
BY_SUFFIX: dict[str, tuple[Mutation, ...]] = {
    **dict.fromkeys((".toml", ".csv", ".txt", ".vrt", ".obj", ".mtl", ".out", ".pgw", ".xml", ".prj"), TEXT),
    **dict.fromkeys((".json", ".gltf"), (changed_json, changed_json, changed_json, changed_json, *TEXT)),
    ".glb": (changed_glb, changed_glb, changed_glb, *BINARY),
    ".spz": (changed_gzip, changed_gzip, changed_gzip, *BINARY),
    ".npz": (changed_npz, changed_npz, *BINARY),
    ".png": (huge_png, *BINARY),
    ".ply": (*BINARY, written_number, written_number),
}


def _place(data: bytes, rng: random.Random, size: int) -> int:
    """Where to begin: half of the time in the header."""
    last = max(1, len(data) - size + 1)
    return rng.randrange(min(HEAD, last)) if rng.random() < 0.5 else rng.randrange(last)


def damage(path: Path, rng: random.Random, others: list[Path]) -> str:
    """Replace a file by a damaged one, or by something that is no file; returns what was done."""
    data = path.read_bytes()
    path.unlink()  # the seed has another link to it
    kind = rng.random()
    if kind < 0.08:
        return _replaced(path, rng, others)
    done = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if not data:
            break
        mutation = rng.choice(BY_SUFFIX.get(path.suffix.lower(), BINARY))
        try:
            data = mutation(data, rng)
        except (
            ValueError,
            LookupError,
            MemoryError,
            OSError,
            EOFError,
            struct.error,
            zlib.error,
            zipfile.BadZipFile,
            RecursionError,
        ):
            mutation, data = flipped, flipped(data, rng)  # of a file that is damaged already
        done.append(mutation.__name__)
    path.write_bytes(data)
    return " ".join(done)


def _replaced(path: Path, rng: random.Random, others: list[Path]) -> str:
    kind = rng.choice(("empty", "missing", "folder", "loop", "endless", "pipe", "other", "other", "other"))
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "endless":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "other":
        path.write_bytes(rng.choice(others).read_bytes())
    return kind
