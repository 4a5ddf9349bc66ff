"""Mutations of valid files: bytes, cells, keys, attributes and arrays replaced by what no file of an arm holds."""

from __future__ import annotations

import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from copy import deepcopy
from itertools import zip_longest
from typing import Any
from xml.sax.saxutils import quoteattr

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
    *("a" * 5000, "9" * 5000, "${GAPSCOPE_DATA}/x", "{j}{j}{joint}", "'\"<&>"),
    "kuka_iiwa",
)
OTHERS: tuple[Any, ...] = (
    *(None, True, [], {}, [[]], [[1.0], 2], {"a": {"a": {}}}, [1e400] * 3),
)
PICKLE = b"cposix\nsystem\n(S'touch pwned'\ntR."


def nasty(rng: random.Random) -> Any:
    """A value that hardly fits anywhere."""
    kinds = rng.choices((NUMBERS, TEXTS, OTHERS), (5, 3, 2))[0]
    # a copy: later mutations must not change what the next input is given
    return deepcopy(rng.choice(kinds))


def of_bytes(content: bytes, rng: random.Random) -> bytes:
    """Cut, flipped, repeated, overwritten bytes."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        place = rng.randrange(max(len(data), 1))
        length = rng.choice((1, 1, 2, 4, 8, 64, 512))
        repeated = data[place : place + length] * rng.choice((1, 3, 200))
        kind = rng.randrange(8)
        if kind == 0:
            del data[place:]
        elif kind == 1 and data:
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 2:
            del data[place : place + length]
        elif kind == 3:
            data[place:place] = repeated
        else:
            number = struct.pack("<d", float(rng.choice(NUMBERS[:11])))
            size = rng.choice((0, 1, 2**31, 2**32 - 1, 2**62, 2**64 - 1))
            long = struct.pack("<Q", size)
            new = rng.choice((rng.randbytes(length), number, long, long[:4]))
            data[place : place + len(new)] = new
    return bytes(data)


def _place(value: Any, rng: random.Random) -> tuple[Any, Any]:
    """Parent and key of a value inside plain data, at any depth."""
    parent = key = None
    while isinstance(value, (dict, list)) and value:
        if parent is not None and rng.random() < 0.3:
            break
        parent = value
        key = rng.choice(list(value if isinstance(value, dict) else range(len(value))))
        value = parent[key]
    return parent, key


def _scaled(value: Any, factor: float) -> Any:
    try:
        return factor * float(value)
    except (TypeError, ValueError, OverflowError):
        return value


def of_data(value: Any, rng: random.Random) -> Any:
    """Plain data with some values replaced, removed, repeated, scaled or nested."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        parent, key = _place(value, rng)
        if parent is None:
            return nasty(rng)
        found, kind = parent[key], rng.randrange(9)
        if kind <= 3:
            parent[key] = nasty(rng)
        elif kind == 4:
            del parent[key]
        elif kind == 5:
            parent[key] = [found] * rng.choice((0, 1, 2, 9))
        elif kind == 6 and isinstance(parent, dict):
            parent[rng.choice(("x", "schema", "effects", "joints", ""))] = found
        elif kind <= 7 and isinstance(found, list):
            factor = rng.choice((-1, 57.3, 1e12, *NUMBERS[:8]))
            parent[key] = [_scaled(x, factor) for x in found]
        else:
            for _ in range(rng.choice((1, 3, 60))):
                parent[key] = [parent[key]]
    return value


def of_csv(content: bytes, rng: random.Random) -> bytes:
    """Cells, columns, rows, separators and the header."""
    rows = [line.split(",") for line in content.decode().splitlines()]
    if rng.random() < 0.2:
        names = ("t", "q1", "q3", "dq1", "tau9", "q01", "")
        rows[0][rng.randrange(len(rows[0]))] = rng.choice(names)
    if rng.random() < 0.3:
        row = rng.randrange(len(rows))
        rows[row:] = rows[row:][:: rng.choice((-1, 2, 25))] * rng.choice((0, 1, 3))
    if rng.random() < 0.7:
        turned = rng.random() < 0.5
        table = of_data([*zip(*rows, strict=True)] if turned else rows, rng)
        rows = [x if isinstance(x, list) else [x] for x in table]
        rows = [*zip_longest(*rows, fillvalue="")] if turned else rows
    separator = rng.choice((",", ",", ",", ",", ";", "\t", " ", "|"))
    text = "\n".join(separator.join(map(str, cells)) for cells in rows)
    return text.encode("utf-8", "surrogatepass")


def of_json(content: bytes, rng: random.Random) -> bytes:
    """Values of a JSON document; nesting beyond any reader's depth."""
    if rng.random() < 0.02:
        return b"[" * rng.choice((10, 100_000))
    return json.dumps(of_data(json.loads(content), rng)).encode()


YAML_TEXTS = (
    *("!!python/object/apply:os.system ['touch pwned']", "!!python/name:os.system"),
    *("!!binary '////'", "!!timestamp 2020-99-99", "!!int x", "!!set {a, b}"),
    *("!!map [1, 2]", "&a [*a, *a]", "{<<: *b}", "2020-01-01T99:99:99Z", "190:20:30"),
    *("0001-01-01T00:00:00+23:59", "? [a, b]", "{? {a: b} : c}", "[" * 3000),
    *("- " * 3000, "%YAML 9.9", "---\n---\n"),
)
BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefghi", "bcdefghij", strict=True)
)


def of_yaml(content: bytes, rng: random.Random) -> bytes:
    """Values of a YAML document; tags, anchors, dates, aliases of aliases."""
    kind = rng.random()
    if kind < 0.7:
        text = json.dumps(of_data(yaml.safe_load(content), rng))
        return text.replace("NaN", ".nan").replace("Infinity", ".inf").encode()
    lines = content.decode().splitlines()
    place = rng.randrange(len(lines))
    key, value = lines[place].split(":")[0], rng.choice(YAML_TEXTS)
    if kind >= 0.95:
        lines.insert(0, BOMB)
        value = f"*{rng.choice('abj')}"
    lines[place] = f"{key}: {value}"
    return "\n".join(lines).encode()


ENTITIES = (
    '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
    '<!DOCTYPE r [<!ENTITY % a SYSTEM "http://127.0.0.1:9/x"> %a;]>',
    '<!DOCTYPE r [<!ENTITY a "9">'
    + "".join(
        f'<!ENTITY {new} "{f"&{old};" * 10}">'
        for old, new in zip("abcdefghi", "bcdefghij", strict=True)
    )
    + "]>",
)


XML_PARTS = (
    *('"[^"]*"',) * 3,
    r' \w+="[^"]*"',
    r"<\w[^<>]*/>",
    r"<(?:link|joint|body|inertial)\b.*?</(?:link|joint|body|inertial)>",
)
"""What is changed in an XML file: values of attributes, most often; attributes; elements."""


def of_xml(content: bytes, rng: random.Random) -> bytes:
    """Attributes and elements; entities; nesting beyond any reader's depth."""
    if rng.random() < 0.03:
        named = content.decode().replace('"', f'"&{rng.choice("aj")};', 1)
        return (rng.choice(ENTITIES) + named).encode()
    if rng.random() < 0.005:
        return b"<robot name='a'>" + b"<link>" * rng.choice((200, 60_000))
    text = content.decode()
    for _ in range(rng.choice((1, 1, 2, 4))):
        pattern = rng.choice(XML_PARTS)
        parts = re.split(f"({pattern})", text, flags=re.DOTALL)
        if len(parts) == 1:
            continue
        place = rng.randrange(1, len(parts), 2)
        if pattern == XML_PARTS[0]:
            words = parts[place].strip('"').split() or [""]
            words[rng.randrange(len(words))] = str(nasty(rng)).replace("\0", "")
            parts[place] = quoteattr(" ".join(words))
        else:
            parts[place] *= rng.choice((0, 0, 2))
        text = "".join(parts)
    return text.encode("utf-8", "surrogatepass")


def of_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    """An array with other values, shape or kind."""
    kind = rng.randrange(8)
    array = np.array(array)
    numbers = array.dtype.kind in "fiu"
    if kind <= 2 and array.size and numbers:
        array = array.astype(float)
        array.flat[rng.randrange(array.size)] = float(rng.choice(NUMBERS[:18]))
        return array
    if kind == 3:
        return array[: rng.randrange(3)] if array.ndim else np.zeros((2, 2))
    if kind == 4:
        return rng.choice((array[..., None], array.reshape(-1), array.T))
    if kind == 5 and numbers:
        kinds = ("U9", "S3", "complex64", "int8", "bool", "float16")
        return array.astype(rng.choice(kinds))
    if kind == 6 and numbers:
        return np.full_like(array, rng.choice((0, 1, 127)))
    return np.zeros(rng.choice(((0,), (0, 3), (3, 0), (2, 2, 2), (60,), ())))


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
    if kind == 7:
        odd = {
            "object": _npy("|O", "(1,)") + PICKLE,
            "large": _npy("<f8", f"({10**12},)"),
            "bomb": _npy("<f8", "(4000000,)") + bytes(32_000_000),
            name: rng.randbytes(40),
        }
        with zipfile.ZipFile(out, "a", zipfile.ZIP_DEFLATED) as archive:
            chosen = rng.choice(list(odd))
            archive.writestr(f"{chosen}.npy", odd[chosen])
    return out.getvalue()


def _npy(kind: str, shape: str) -> bytes:
    """The header of an array's file."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
    text = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def either(structured: Mutation, share: float = 0.7) -> Mutation:
    """The structured mutation, or else one of bytes; both for some."""

    def mutate(content: bytes, rng: random.Random) -> bytes:
        if rng.random() < share:
            content = structured(content, rng)
            return of_bytes(content, rng) if rng.random() < 0.1 else content
        return of_bytes(content, rng)

    return mutate
