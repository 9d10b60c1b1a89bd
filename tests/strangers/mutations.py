"""Files of every format, damaged as accidents and attackers damage them: by what they mean, not by bits alone."""

from __future__ import annotations

import copy
import json
import re
import struct
import tomllib
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple
from xml.etree import ElementTree

from hypothesis import strategies as st


class Edit(NamedTuple):
    """One change: ``how`` picks the kind, ``where`` the place, ``what`` the new content."""

    how: int
    where: int
    what: int


EDITS = st.lists(
    st.builds(Edit, how=st.integers(0, 63), where=st.integers(0, 2**32 - 1), what=st.integers(0, 2**32 - 1)),
    min_size=1,
    max_size=4,
)
VALUES: list[Any] = [
    None, True, False, 0, 1, -1, 2, 255, 256, 65535, 2**31 - 1, 2**31, -(2**31), 2**32 - 1, 2**53 + 1, 2**63,
    -(2**63), 2**64, 10**18, 10**19, 10**30, int("9" * 400), 0.5, -0.0, 1e-320, 1e-30, 1e9, 1e30, 1e38, 1e39, 1e154,
    1e300, -1e308, float("inf"), float("-inf"), float("nan"), "", ".", "..", "/", "//server/share", "a\nb", "\x00",
    "\x1b[2J", "\ud800", "x" * 300, "x" * 5000, "\u202e", "~nosuchuser/x", "/dev/zero", "1", "nan", "scene.ply",
    "images/000.png", [], {}, [[]], [1], [1, 2, 3], [1, [2]], [None], {"": 0}, {"keys": []},
    {"keys": [[0, 1], [1, 2]]}, {"keys": [[0, [1]], [1, 2]]}, [0] * 1000, [[0.0] * 4] * 4, {"x": {"x": {"x": {}}}},
]  # fmt: skip
"""What JSON may hold in the place of a value."""
WORDS = [
    b"0", b"-1", b"1e400", b"nan", b"inf", b"-inf", b"9" * 30, b"9" * 5000, b"1e-320", b"0x10", b"1_000", b"",
    b"\x00", b"\xff\xfe", b"\n", b"\r", b" " * 300, b"#", b'"', b",", b"-", b"//", b"..", b"\x1b[2J", "é".encode(),
    b"4294967296", b"18446744073709551616", b"1e38", b"1e300",
]  # fmt: skip
"""What text may hold in the place of a word."""
XML_TEXTS = ["", " ", "0", "-1", "1e400", "nan", "inf", "9" * 5000, "1e-320", "1e38", "1e300", "x", "1 2 3", "0 " * 9,
    "nan " * 16, "0 " * 16, "1e300 " * 9, "1 " * 5000, "true", "../x", "/dev/zero", "a\nb", "\u202e", "fisheye",
    "brown4t2", "4294967296"]  # fmt: skip
"""What XML may hold in the place of a text."""
INTEGERS = [
    0,
    1,
    2,
    3,
    127,
    128,
    255,
    256,
    32767,
    32768,
    65535,
    65536,
    2**24,
    2**31 - 1,
    2**31,
    2**32 - 1,
    100_000,
    20_000_001,
]


def damaged_bytes(data: bytes, edit: Edit) -> bytes:
    """``data`` with bytes, or a number of 1, 2, 4 or 8 of them, changed, inserted, removed, repeated or cut off."""
    if not data:
        return bytes([edit.what & 255])
    at = edit.where % len(data)
    end = min(len(data), at + 1 + edit.what % 64)
    number = INTEGERS[edit.what % len(INTEGERS)]
    size = (1, 2, 4, 8)[edit.what // 64 % 4]
    packed = (number % 2 ** (8 * size)).to_bytes(size, "big" if edit.what // 256 % 2 else "little")
    real = struct.pack("<f", [0.0, -1.0, 1e30, 3e38, float("nan"), float("inf")][edit.what % 6])
    return {
        0: lambda: data[:at] + bytes([data[at] ^ (1 << edit.what % 8)]) + data[at + 1 :],
        1: lambda: data[:at] + bytes([edit.what & 255]) + data[at + 1 :],
        2: lambda: data[:at] + packed + data[at + size :],
        3: lambda: data[:at] + packed + data[at:],
        4: lambda: data[:at] + data[end:],
        5: lambda: data[:at],
        6: lambda: data[:end] + data[at:end] * (1 + edit.what % 8) + data[end:],
        7: lambda: data[:at] + real + data[at + 4 :],
        8: lambda: data + data[at:end],
        9: lambda: data[:at] + bytes(64) + data[at + 64 :],
        10: lambda: data[at:],
    }[edit.how % 11]()


def damaged_head(data: bytes, edit: Edit) -> bytes:
    """Like :func:`damaged_bytes`, within the first 400 bytes, where formats have their sizes."""
    return damaged_bytes(data[:400], edit) + data[400:] if edit.how % 3 else damaged_bytes(data, edit)


def damaged_text(data: bytes, edit: Edit) -> bytes:
    """``data`` with a word replaced, or a line removed, repeated, moved or inserted; now and then as bytes."""
    kind = edit.how % 8
    if kind == 7:
        return damaged_bytes(data, Edit(edit.what, edit.where, edit.how))
    if kind < 4:
        words = list(re.finditer(rb"[^\s,\"/{}\[\]=]+", data))
        if not words:
            return data
        word = words[edit.where % len(words)]
        return data[: word.start()] + WORDS[edit.what % len(WORDS)] + data[word.end() :]
    lines = data.split(b"\n")
    at = edit.where % len(lines)
    if kind == 4:
        del lines[at]
    elif kind == 5:
        lines[at:at] = [lines[edit.what % len(lines)]] * (1 + edit.what % 3)
    else:
        lines.insert(at, WORDS[edit.what % len(WORDS)] * (1 + edit.what % 5))
    return b"\n".join(lines)


def damaged_json(data: bytes, edit: Edit) -> bytes:
    """``data`` with a value replaced, removed, nested or doubled; now and then as text."""
    if edit.how % 10 == 9:
        return damaged_text(data, Edit(edit.what, edit.where, edit.how))
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return damaged_text(data, edit)
    return json.dumps(damaged_value(content, edit)).encode()


def damaged_value(content: Any, edit: Edit) -> Any:
    """A copy of ``content`` with one of its values changed."""
    content = copy.deepcopy(content)
    places: list[tuple[Any, Any]] = []
    boxes = [content]
    while boxes:
        box = boxes.pop()
        for key, item in box.items() if isinstance(box, dict) else enumerate(box) if isinstance(box, list) else ():
            places.append((box, key))
            boxes.append(item)
    if not places:
        return VALUES[edit.what % len(VALUES)]
    box, key = places[edit.where % len(places)]
    other = VALUES[edit.what % len(VALUES)]
    kind = edit.how % 8
    if kind < 4:
        box[key] = other
    elif kind == 4:
        del box[key]
    elif kind == 5:
        box[key] = [box[key]]
    elif kind == 6 and isinstance(box, dict):
        box[other if isinstance(other, str) else f"{key}_"] = box[key]
    else:
        box[key] = copy.deepcopy(places[edit.what % len(places)][0])
        if len(json.dumps(content)) > 1_000_000:
            box[key] = other
    return content


def damaged_png(data: bytes, edit: Edit) -> bytes:
    """``data`` with a chunk changed, removed, repeated or renamed, its checksum right again; now and then as bytes."""
    if edit.how % 6 == 5 or data[:8] != b"\x89PNG\r\n\x1a\n":
        return damaged_head(data, edit)
    chunks, at = [], 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    if not chunks:
        return data
    n = edit.where % len(chunks)
    kind, content = chunks[n]
    if edit.how % 6 == 0:
        del chunks[n]
    elif edit.how % 6 == 1:
        chunks.insert(edit.what % len(chunks), chunks[n])
    elif edit.how % 6 == 2:
        names = (
            b"tEXt",
            b"zTXt",
            b"iCCP",
            b"eXIf",
            b"PLTE",
            b"tRNS",
            b"acTL",
            b"fcTL",
            b"IDAT",
            b"IEND",
            b"gAMA",
            b"iTXt",
            b"cHRM",
            b"sBIT",
        )
        chunks.insert(n, (names[edit.what % len(names)], content[: edit.what % 64]))
    else:
        inner = Edit(edit.what, edit.where // len(chunks), edit.what // 11)
        chunks[n] = (kind, damaged_bytes(content, inner)[: 1 << 20])
    whole = (struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)
    return data[:8] + b"".join(whole)


def damaged_glb(data: bytes, edit: Edit) -> bytes:
    """``data`` with its JSON changed and the lengths right again; now and then as bytes."""
    if edit.how % 4 == 3 or len(data) < 20:
        return damaged_head(data, edit)
    length = int.from_bytes(data[12:16], "little")
    text = damaged_json(data[20 : 20 + length], Edit(edit.how // 4, edit.where, edit.what))
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = data[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + data[16:20]
    return head + text + rest


def damaged_toml(data: bytes, edit: Edit) -> bytes:
    """``data`` with a value replaced, removed, nested or doubled, and written again; now and then as text."""
    try:
        content = tomllib.loads(data.decode())
    except ValueError:
        return damaged_text(data, edit)
    if edit.how % 3 == 2:
        return damaged_text(data, Edit(edit.what, edit.where, edit.how))
    content = damaged_value(content, edit)
    if not isinstance(content, dict):
        return damaged_text(data, edit)
    lines = (f"{json.dumps(str(key))} = {_toml(value)}\n" for key, value in content.items())
    return "".join(lines).encode(errors="replace")


def _toml(value: Any) -> str:
    """``value`` in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps("" if value is None else value)


def damaged_xml(data: bytes, edit: Edit) -> bytes:
    """``data`` with an attribute or a text replaced, or an element removed, repeated, nested or emptied; now and then
    as text."""
    kind = edit.how % 8
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError):
        return damaged_text(data, edit)
    if kind == 7:
        return damaged_text(data, Edit(edit.what, edit.where, edit.how))
    elements = list(root.iter())
    parent = elements[edit.where % len(elements)]
    word = XML_TEXTS[edit.what % len(XML_TEXTS)]
    if kind < 2 and parent.attrib:
        parent.set(list(parent.attrib)[edit.where // 7 % len(parent.attrib)], word)
    elif kind == 2 and parent.attrib:
        del parent.attrib[list(parent.attrib)[edit.where // 7 % len(parent.attrib)]]
    elif kind < 4 or not len(parent):
        parent.text = word
    elif kind == 4:
        del parent[edit.where // 7 % len(parent)]
    elif kind == 5:
        parent.extend([copy.deepcopy(parent[edit.where // 7 % len(parent)])] * (1 + edit.what % 3))
    else:
        parent.append(copy.deepcopy(elements[edit.what % len(elements)]))
    return ElementTree.tostring(root)


def damaged_exr(data: bytes, edit: Edit) -> bytes:
    """``data`` with an attribute of its header changed, removed, repeated or retyped; now and then as bytes."""
    if edit.how % 5 == 4 or data[:4] != b"\x76\x2f\x31\x01":
        return damaged_head(data, edit)
    attributes, at = [], 8
    while at < len(data) and data[at]:
        name, kind, rest = (data[at:] + b"\0\0").split(b"\0", 2)
        size = int.from_bytes(rest[:4], "little")
        attributes.append((name, kind, rest[4 : 4 + size]))
        at += len(name) + len(kind) + 6 + size
    if not attributes:
        return damaged_head(data, edit)
    n = edit.where % len(attributes)
    name, kind, value = attributes[n]
    if edit.how % 5 == 0:
        del attributes[n]
    elif edit.how % 5 == 1:
        attributes.insert(edit.what % len(attributes), attributes[n])
    elif edit.how % 5 == 2:
        attributes[n] = (name, attributes[edit.what % len(attributes)][1], value)
    else:
        inner = Edit(edit.what, edit.where // len(attributes), edit.what // 11)
        attributes[n] = (name, kind, damaged_bytes(value, inner)[: 1 << 20])
    whole = (n + b"\0" + k + b"\0" + struct.pack("<I", len(v)) + v for n, k, v in attributes)
    return data[:8] + b"".join(whole) + data[at:]


DAMAGE: dict[str, Callable[[bytes, Edit], bytes]] = {
    ".json": damaged_json,
    ".sfm": damaged_json,
    ".toml": damaged_toml,
    ".xml": damaged_xml,
    ".xmp": damaged_xml,
    ".csv": damaged_text,
    ".txt": damaged_text,
    ".traj": damaged_text,
    ".pincam": damaged_text,
    ".obj": damaged_text,
    ".out": damaged_text,
    ".png": damaged_png,
    ".glb": damaged_glb,
    ".ply": damaged_head,
    ".jpg": damaged_head,
    ".hdr": damaged_head,
    ".webp": damaged_head,
    ".tif": damaged_bytes,
    ".bmp": damaged_head,
    ".avif": damaged_head,
    ".heic": damaged_head,
    ".dng": damaged_bytes,
    ".exr": damaged_exr,
    ".npy": damaged_head,
    ".npz": damaged_bytes,
    ".bin": damaged_bytes,
}
"""How a file is damaged, by its suffix."""
