"""Mutations of valid files: bytes, cells, keys, attributes and arrays replaced by what no file of an arm holds."""

from __future__ import annotations

import io
import json
import random
import struct
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import yaml

Mutation = Callable[[bytes, random.Random], bytes]

OUTSIDE = "secret.csv"
"""Name of a file beside the working folder that no input may make a reader open, but a case that names it."""
NUMBERS: tuple[Any, ...] = (
    *(float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1e12, 1e30, 1e-320),
    *(-0.0, 0, -1, 1, 3, 2**31, -(2**31), 2**63, 2**64, 10**30, 10**400),
)
TEXTS = (
    *("", " ", "nan", "-inf", "1e12", "1e999", "0x10", "1_0", "1,5", "٣", "\0", "�"),
    *(f"../{OUTSIDE}", f"/proc/self/../../{OUTSIDE}", "/dev/zero", "/dev/stdin", "."),
    *(
        "a" * 5000,
        "${GAPSCOPE_DATA}/x",
        "{j}{j}{joint}",
        "'\"<&>",
        "kuka_iiwa",
        "9" * 5000,
    ),
)
OTHERS: tuple[Any, ...] = (
    None,
    True,
    [],
    {},
    [[]],
    [[1.0], 2],
    {"a": {"a": {}}},
    [1e400] * 3,
)
PICKLE = b"cposix\nsystem\n(S'touch pwned'\ntR."


def nasty(rng: random.Random) -> Any:
    """A value that hardly fits anywhere."""
    kind = rng.random()
    if kind < 0.5:
        return rng.choice(NUMBERS)
    # a copy: later mutations must not change what the next input is given
    return deepcopy(rng.choice(TEXTS if kind < 0.8 else OTHERS))


def of_bytes(content: bytes, rng: random.Random) -> bytes:
    """Cut, flipped, repeated, overwritten bytes."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        size = max(len(data), 1)
        place, length = rng.randrange(size), rng.choice((1, 1, 2, 4, 8, 64, 512))
        kind = rng.randrange(8)
        if kind == 0:
            del data[place:]
        elif kind == 1 and data:
            data[place % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 2:
            data[place : place + length] = rng.randbytes(length)
        elif kind == 3:
            del data[place : place + length]
        elif kind == 4:
            data[place:place] = data[place : place + length] * rng.choice((1, 3, 200))
        elif kind == 5:
            data[place : place + 4] = struct.pack(
                "<I", rng.choice((0, 1, 2**31, 2**32 - 1))
            )
        elif kind == 6:
            data[place : place + 8] = struct.pack(
                "<Q", rng.choice((0, 2**31, 2**62, 2**64 - 1))
            )
        else:
            number = float(rng.choice(NUMBERS[:11]))
            data[place : place + 8] = struct.pack("<d", number)
    return bytes(data)


def of_csv(content: bytes, rng: random.Random) -> bytes:
    """Cells, columns, rows, separators and the header."""
    rows = [line.split(",") for line in content.decode().splitlines()]
    for _ in range(rng.choice((1, 1, 2, 3))):
        row, column = rng.randrange(len(rows)), rng.randrange(len(rows[0]))
        kind = rng.randrange(11)
        if kind <= 2:
            rows[row][column % len(rows[row])] = str(nasty(rng))
        elif kind == 3:
            value = str(rng.choice(NUMBERS[:16]))
            for cells in rows[1:]:
                cells[column % len(cells)] = value
        elif kind == 4:
            factor = rng.choice((-1.0, 0.0, 57.3, 1e3, 1e6, 1e-3, 1e12, 1e-12))
            for cells in rows[1:]:
                _scale(cells, column % len(cells), factor)
        elif kind == 5:
            rows = [cells[:column] + cells[column + 1 :] or [""] for cells in rows]
        elif kind == 6:
            rows = [[*cells, cells[column % len(cells)]] for cells in rows]
        elif kind == 7:
            rows[row:] = rows[row:][:: rng.choice((-1, 2, 25))] or [["t"]]
        elif kind == 8:
            rows[row:row] = [list(rows[row])] * rng.choice((1, 3, 40))
        elif kind == 9:
            rows[0][column % len(rows[0])] = rng.choice(
                ("t", "q1", "q3", "dq1", "tau9", "q01", "")
            )
        else:
            rows = rows[: rng.choice((0, 1, 2, 5))] or [[""]]
    separator = rng.choice((",", ",", ",", ",", ";", "\t", " ", "|"))
    text = "\n".join(separator.join(cells) for cells in rows)
    return text.encode("utf-8", "surrogatepass")


def _scale(cells: list[str], column: int, factor: float) -> None:
    try:
        cells[column] = repr(float(cells[column]) * factor)
    except ValueError:
        cells[column] = ""


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all values inside plain data."""
    found = [path] if path else []
    if isinstance(value, dict):
        for key in value:
            found += _places(value[key], (*path, key))
    elif isinstance(value, list):
        for number in range(len(value)):
            found += _places(value[number], (*path, number))
    return found


def of_data(value: Any, rng: random.Random) -> Any:
    """Plain data with some values replaced, removed, repeated or nested."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places = _places(value)
        if not places:
            return nasty(rng)
        *above, last = rng.choice(places)
        parent = value
        for step in above:
            parent = parent[step]
        kind = rng.randrange(8)
        if kind <= 3:
            parent[last] = nasty(rng)
        elif kind == 4:
            del parent[last]
        elif kind == 5:
            parent[last] = [parent[last]] * rng.choice((0, 1, 2, 9))
        elif kind == 6 and isinstance(parent, dict):
            parent[rng.choice(("x", "schema", "effects", "joints", ""))] = parent[last]
        else:
            for _ in range(rng.choice((1, 3, 60))):
                parent[last] = [parent[last]]
    return value


def of_json(content: bytes, rng: random.Random) -> bytes:
    """Values of a JSON document; nesting beyond any reader's depth."""
    if rng.random() < 0.02:
        return b"[" * rng.choice((10, 100_000))
    return json.dumps(of_data(json.loads(content), rng)).encode()


YAML_TEXTS = (
    "!!python/object/apply:os.system ['touch pwned']",
    "!!python/name:os.system",
    "!!binary '////'",
    "!!timestamp 2020-99-99",
    "!!int x",
    "!!set {a, b}",
    "!!map [1, 2]",
    "&a [*a, *a]",
    "{<<: *b}",
    "2020-01-01T99:99:99Z",
    "0001-01-01T00:00:00+23:59",
    "190:20:30",
    "? [a, b]",
    "{? {a: b} : c}",
    "[" * 3000,
    "- " * 3000,
    "%YAML 9.9",
    "---\n---\n",
)
BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(['*' + chr(97 + k)] * 9)}]\n"
    for k in range(9)
)


def of_yaml(content: bytes, rng: random.Random) -> bytes:
    """Values of a YAML document; tags, anchors, dates, aliases of aliases."""
    kind = rng.random()
    if kind < 0.7:
        value = of_data(yaml.safe_load(content), rng)
        return (
            json.dumps(value)
            .replace("NaN", ".nan")
            .replace("Infinity", ".inf")
            .encode()
        )
    lines = content.decode().splitlines()
    place = rng.randrange(len(lines))
    if kind < 0.95:
        key = lines[place].split(":")[0]
        lines[place] = f"{key}: {rng.choice(YAML_TEXTS)}"
    else:
        lines.insert(0, BOMB)
        lines[place] = lines[place].split(":")[0] + f": *{rng.choice('abj')}"
    return "\n".join(lines).encode()


ENTITIES = (
    '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
    '<!DOCTYPE r [<!ENTITY % a SYSTEM "http://127.0.0.1:9/x"> %a;]>',
    '<!DOCTYPE r [<!ENTITY a "9">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9))
    + "]>",
)


def of_xml(content: bytes, rng: random.Random) -> bytes:
    """Attributes and elements; entities; nesting beyond any reader's depth."""
    if rng.random() < 0.03:
        entity = rng.choice(ENTITIES)
        return (
            entity + content.decode().replace('"', f'"&{rng.choice("aj")};', 1)
        ).encode()
    if rng.random() < 0.005:
        return b"<robot name='a'>" + b"<link>" * rng.choice((200, 60_000))
    root = ET.fromstring(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        element = rng.choice(list(root.iter()))
        kind = rng.randrange(6)
        if kind <= 2 and element.attrib:
            key = rng.choice(sorted(element.attrib))
            words = element.attrib[key].split() or [""]
            value = nasty(rng)
            text = str(value) if not isinstance(value, (list, dict)) else ""
            words[rng.randrange(len(words))] = text
            element.attrib[key] = " ".join(words)
        elif kind == 3 and element.attrib:
            del element.attrib[rng.choice(sorted(element.attrib))]
        elif len(element):
            child = rng.choice(list(element))
            if kind == 4:
                element.remove(child)
            else:
                rng.choice(list(root.iter())).append(deepcopy(child))
    text = ET.tostring(root, encoding="unicode")
    return text.replace("\0", "").encode("utf-8", "surrogatepass")


def of_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    """An array with other values, shape or kind."""
    kind = rng.randrange(9)
    array = np.array(array)
    if kind <= 2 and array.size and array.dtype.kind in "fiu":
        array = array.astype(float)
        array.flat[rng.randrange(array.size)] = float(rng.choice(NUMBERS[:18]))
        return array
    if kind == 3:
        return array[: rng.randrange(3)] if array.ndim else np.zeros((2, 2))
    if kind == 4:
        return array[..., None] if rng.random() < 0.5 else array.reshape(-1)
    if kind == 5:
        return np.zeros(rng.choice(((0,), (0, 3), (3, 0), (2, 2, 2), (60,), ())))
    if kind == 6 and array.dtype.kind in "fiu":
        return array.astype(
            rng.choice(("U9", "S3", "complex64", "int8", "bool", "float16"))
        )
    if kind == 7 and array.dtype.kind in "fiu":
        return np.full_like(array, rng.choice((0, 1, 127)))
    return array.T


def of_npz(content: bytes, rng: random.Random) -> bytes:
    """Arrays, names, pickled objects, sizes that the archive does not hold."""
    with np.load(io.BytesIO(content), allow_pickle=False) as held:
        arrays: dict[str, Any] = dict(held)
    name = rng.choice(sorted(arrays))
    kind = rng.randrange(8)
    if kind <= 4:
        arrays[name] = of_array(arrays[name], rng)
    elif kind == 5:
        del arrays[name]
    elif kind == 6:
        arrays[rng.choice(("t", "q", "../x", "a/b"))] = of_array(np.arange(60.0), rng)
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    if kind != 7:
        return out.getvalue()
    with zipfile.ZipFile(out, "a", zipfile.ZIP_DEFLATED) as archive:
        odd = rng.randrange(4)
        if odd == 0:
            archive.writestr(
                "object.npy", b"\x93NUMPY\x01\x00" + _header("|O", "(1,)") + PICKLE
            )
        elif odd == 1:
            archive.writestr(
                "large.npy", b"\x93NUMPY\x01\x00" + _header("<f8", f"({10**12},)")
            )
        elif odd == 2:
            archive.writestr(
                "bomb.npy",
                b"\x93NUMPY\x01\x00" + _header("<f8", "(4000000,)") + bytes(32_000_000),
            )
        else:
            archive.writestr(name + ".npy", rng.randbytes(40))
    return out.getvalue()


def _header(kind: str, shape: str) -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
    text = text.ljust(117) + "\n"
    return struct.pack("<H", len(text)) + text.encode()


def either(structured: Mutation, share: float = 0.7) -> Mutation:
    """The structured mutation, or else one of bytes; both for some."""

    def mutate(content: bytes, rng: random.Random) -> bytes:
        if rng.random() < share:
            content = structured(content, rng)
            return of_bytes(content, rng) if rng.random() < 0.1 else content
        return of_bytes(content, rng)

    return mutate
