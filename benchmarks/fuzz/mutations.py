"""Ways to damage a file: bytes, GRIB headers, cells of tables, values of YAML, attributes.

Every mutation depends on its random generator alone: a case can be repeated from its number.
"""

import re

import numpy as np

SCALARS = [
    *("2009-06-31", "2009-02-30T25:61:00Z", "2009-01-01T00:00:00+99:00", '!!int "9e9"'),
    *('!!float "x"', "!!timestamp 'soon'", "!!python/object/apply:os.system ['true']"),
    *("!!binary '***'", "~", "''", "9" * 400, "1e999", "-.inf", ".nan", "0x" + "f" * 200),
    *("[[[[[[[[[[]]]]]]]]]]", "{a: {b: {c: d}}}", "&a [*a]", "*nothing", "2 h**9**9**9", "1e308 h"),
    *("-3 h", "10 furlong", '"\\0"', '"\\ud800"', "<script>alert(1)</script>"),
    *("../../../../etc/passwd", "| \n  text\n  more", "true", "3 lightyears", "[" * 60 + "]" * 60),
    *("x" * 5000, "\u202e\u0000\u0007", "%s%n{0}", "nan kt", "1_000", "1:30:00"),
]
CELLS = [
    *("", "nan", "inf", "-inf", "1e400", "-1e9", "99999", "abc", '"', '""",', "\0", "0x10", "1,5"),
    *("--", "2009-13-45T99:99", "1900-01-01", "9999-12-31T23:59:60Z", "١٢٣", "<b>x</b>", "=1+1"),
    *("N" * 3000, "1253091600000", "1253091600000000000", "-180", "361", "720.5", "\ufeff"),
    *("True", "None"),
]


def mutated(kind, data, donor, pick):
    """Damage the bytes of a file of some kind in one to four ways; ``other`` is spliced in."""
    changes = [*BYTES, lambda d, p: _spliced(d, donor, p)]
    if kind.startswith("grib"):
        changes = [*changes, *GRIB, *GRIB, *GRIB]
    elif kind == "bufr":
        changes = [*changes, *[_bufr_header] * 10]
    elif kind in ("yaml", "effects"):
        changes = [*YAML, *YAML, *YAML, *changes]
    elif kind == "csv":
        changes = [*CSV, *CSV, *CSV, *changes]
    for _ in range(pick.choice((1, 1, 1, 2, 4))):
        data = pick.choice(changes)(data, pick)
    return data


def _bits(data, pick):
    changed = bytearray(data)
    for _ in range(pick.choice((1, 1, 2, 8)) if data else 0):
        changed[pick.randrange(len(changed))] ^= 1 << pick.randrange(8)
    return bytes(changed)


def _bytes(data, pick):
    changed = bytearray(data)
    for _ in range(pick.choice((1, 2, 4)) if data else 0):
        extremes = (0, 0xFF, 0x80, 0x7F, pick.randrange(256))
        changed[pick.randrange(len(changed))] = pick.choice(extremes)
    return bytes(changed)


def _cut(data, pick):
    return data[: pick.randrange(len(data) + 1)]


def _run(data, pick):
    start = pick.randrange(len(data) + 1)
    return start, min(len(data), start + pick.choice((1, 2, 4, 16, 64, 512)))


def _inserted(data, pick):
    start, _ = _run(data, pick)
    return data[:start] + pick.randbytes(pick.choice((1, 2, 3, 8, 100))) + data[start:]


def _deleted(data, pick):
    start, stop = _run(data, pick)
    return data[:start] + data[stop:]


def _doubled(data, pick):
    start, stop = _run(data, pick)
    return data[:stop] + data[start:stop] * pick.choice((1, 1, 50)) + data[stop:]


def _blanked(data, pick):
    start, stop = _run(data, pick)
    return data[:start] + bytes([pick.choice((0, 0xFF))]) * (stop - start) + data[stop:]


def _swapped(data, pick):
    a, b, c = sorted(pick.randrange(len(data) + 1) for _ in range(3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def _spliced(data, donor, pick):
    return data[: pick.randrange(len(data) + 1)] + donor[pick.randrange(len(donor) + 1) :]


BYTES = [_bits] * 3
BYTES += [_bytes, _cut, _inserted, _deleted, _doubled, _blanked, _swapped]


def sections(data):
    messages, at = [], data.find(b"GRIB")
    while 0 <= at < len(data) - 16:
        edition = data[at + 7]
        head, width = (8, 3) if edition == 1 else (16, 4)
        total = int.from_bytes(
            data[at + 4 : at + 7] if edition == 1 else data[at + 8 : at + 16], "big"
        )
        message, place = [(at, head)], at + head
        while place < min(at + total, len(data)) - 4 and len(message) < 40:
            length = int.from_bytes(data[place : place + width], "big")
            if not length:
                break
            message.append((place, min(length, len(data) - place)))
            place += length
        messages.append(message)
        at = data.find(b"GRIB", at + 4)
    return messages


def _section(data, pick):
    messages = sections(data)
    return pick.choice(pick.choice(messages)) if messages else _run(data, pick)


def _header_field(data, pick):
    """One field of a section's header set to an extreme, to its neighbour, or at random."""
    start, length = _section(data, pick)
    width = pick.choice((1, 1, 2, 3, 4))
    place = start + pick.randrange(min(max(length, 1), 90))
    if place + width > len(data):
        return data
    most = (1 << 8 * width) - 1
    before = int.from_bytes(data[place : place + width], "big")
    values = [0, 1, most, most >> 1, (most >> 1) + 1, 0x7FFFFFFF, pick.randrange(most + 1)]
    values += [before + 1, before - 1, before ^ (most >> 1) + 1, before * 2, before // 2]
    value = pick.choice(values) & most
    return data[:place] + value.to_bytes(width, "big") + data[place + width :]


def _section_length(data, pick):
    messages = sections(data)
    if not messages:
        return data
    message = pick.choice(messages)
    start, length = pick.choice(message)
    edition = data[message[0][0] + 7]
    if start == message[0][0]:
        start, width = (start + 4, 3) if edition == 1 else (start + 8, 8)
    else:
        width = 3 if edition == 1 else 4
    most = (1 << 8 * width) - 1
    value = pick.choice((0, most, length + 1, length - 1, length * 2, 5, 4, 11, most >> 1)) & most
    return data[:start] + value.to_bytes(width, "big") + data[start + width :]


def _section_doubled(data, pick):
    start, length = _section(data, pick)
    return data[: start + length] + data[start:]


def _section_dropped(data, pick):
    start, length = _section(data, pick)
    return data[:start] + data[start + length :]


def _sections_swapped(data, pick):
    (a, first), (b, second) = sorted((_section(data, pick), _section(data, pick)))
    if a + first > b:
        return data
    swapped = data[b : b + second] + data[a + first : b] + data[a : a + first]
    return data[:a] + swapped + data[b + second :]


def _message_doubled(data, pick):
    messages = sections(data)
    if not messages:
        return data
    number = pick.randrange(len(messages))
    start = messages[number][0][0]
    stop = messages[number + 1][0][0] if number + 1 < len(messages) else len(data)
    return data + _bits(data[start:stop], pick)


def _with_length(change):
    def changed(data, pick):
        messages = sections(data)
        if not messages:
            return data
        start = pick.choice(messages)[0][0]
        edition = data[start + 7]
        end = data.find(b"GRIB", start + 4)
        message = change(data[start : end if end > 0 else len(data)], pick)
        total = len(message)
        if edition == 1:
            message = message[:4] + (total & 0xFFFFFF).to_bytes(3, "big") + message[7:]
        else:
            message = message[:8] + total.to_bytes(8, "big") + message[16:]
        return data[:start] + message + (data[end:] if end > 0 else b"")

    return changed


GRIB = [_header_field] * 4 + [_section_length] * 2
GRIB += [_section_doubled, _section_dropped, _sections_swapped, _message_doubled]
GRIB += [
    _with_length(change)
    for change in (_section_doubled, _section_dropped, _sections_swapped, _inserted, _deleted)
]


def _bufr_header(data, pick):
    """Bytes of the first sections of one BUFR message: lengths, tables, descriptors."""
    starts = [match.start() for match in re.finditer(b"BUFR", data)]
    if not starts:
        return data
    changed, start = bytearray(data), pick.choice(starts)
    for _ in range(pick.choice((1, 2, 2, 3))):
        at = min(start + pick.randrange(8, 48), len(data) - 1)
        changed[at] = pick.choice((0, 0xFF, 0x80, 0x7F, pick.randrange(256)))
    return bytes(changed)


def _yaml_scalar(data, pick):
    text = data.decode("utf-8", "replace")
    places = [match.span(1) for match in re.finditer(r"[:\-,\[] ?([\w./*'\"-][^,\n\]}]*)", text)]
    if not places:
        return data
    start, stop = pick.choice(places)
    return (text[:start] + pick.choice(SCALARS) + text[stop:]).encode("utf-8", "replace")


def _yaml_key(data, pick):
    text = data.decode("utf-8", "replace")
    places = [match.span(1) for match in re.finditer(r"(?m)^\s*(\w+):", text)]
    if not places:
        return data
    start, stop = pick.choice(places)
    keys = ("output", "<<", "reports", "?", "1", "null", "a" * 3000, text[start : stop - 1])
    key = pick.choice(keys)
    return (text[:start] + key + text[stop:]).encode("utf-8", "replace")


def _yaml_line(data, pick):
    lines = data.split(b"\n")
    number = pick.randrange(len(lines))
    line = pick.choice(
        (
            lines[number],
            b"\t" + lines[number],
            b"  " + lines[number],
            lines[number].strip(),
            b"",
            b"a: &a [x, x, x, x, x, x, x, x]\nb: &b [*a, *a, *a, *a, *a, *a, *a, *a]\n"
            b"c: &c [*b, *b, *b, *b, *b, *b, *b, *b]\nd: &d [*c, *c, *c, *c, *c, *c, *c, *c]\n"
            b"e: [*d, *d, *d, *d, *d, *d, *d, *d]",
        )
    )
    return b"\n".join([*lines[: number + 1], line, *lines[number + pick.choice((1, 2)) :]])


YAML = [_yaml_scalar, _yaml_scalar, _yaml_scalar, _yaml_key, _yaml_line]


def _csv_cell(data, pick):
    rows = data.split(b"\n")
    number = pick.choice((0, *range(len(rows))))
    cells = rows[number].split(b",")
    cells[pick.randrange(len(cells))] = pick.choice(CELLS).encode("utf-8", "replace")
    rows[number] = b",".join(cells)
    return b"\n".join(rows)


def _csv_column(data, pick):
    """A whole column filled, dropped, or given again."""
    rows = [row.split(b",") for row in data.split(b"\n")]
    number, way, cell = pick.randrange(len(rows[0])), pick.randrange(4), pick.choice(CELLS).encode()
    for place, row in enumerate(rows):
        if len(row) <= number:
            continue
        if way == 0 and place:
            row[number] = cell
        elif way == 1:
            del row[number]
        elif way == 2:
            row.append(row[number])
        elif way == 3 and place:
            row[number] = b"%.6g" % pick.uniform(-1e5, 1e5)
    return b"\n".join(b",".join(row) for row in rows)


def _csv_rows(data, pick):
    rows = data.split(b"\n")
    number = pick.randrange(len(rows))
    row = pick.choice(
        (rows[0], rows[number], rows[number] + b",1,2,3", b",,,", b'"' + rows[number])
    )
    return b"\n".join([*rows[:number], row, *rows[number + 1 :]])


CSV = [_csv_cell, _csv_cell, _csv_column, _csv_rows]

NAMED = ("units", "standard_name", "scale_factor", "add_offset", "calendar", "axis")
GIVEN = (
    *("", "hPa", "days since 0000-00-00", "hours since 9999-12-31", "furlongs per fortnight"),
    *("eastward_wind", "latitude", 0, -1, 1e30, -1e-30, float("nan"), float("inf"), np.zeros(3)),
    *("x" * 5000, "\u202e<script>alert(1)</script>"),
)
NEW_NAMES = ("u", "v", "time", "q", "XLAT")
_REFUSED = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError)
_REFUSED += (TypeError, ValueError)


def damage_dataset(path, pick):
    """Change attributes, names or values of a NetCDF file in place, through the library."""
    import netCDF4

    with netCDF4.Dataset(path, "a") as file:
        file.set_auto_maskandscale(False)
        for _ in range(pick.choice((1, 1, 2, 3))):
            variable = file.variables[pick.choice(sorted(file.variables))]
            ways = [
                *[lambda v=variable: v.setncattr(pick.choice(NAMED), pick.choice(GIVEN))] * 2,
                lambda v=variable: v.delncattr(pick.choice(v.ncattrs())),
                lambda: file.setncattr(pick.choice(file.ncattrs()), pick.choice(GIVEN)),
                lambda v=variable: file.renameVariable(v.name, pick.choice(NEW_NAMES)),
                *[lambda v=variable: _values(v, pick)] * 3,
            ]
            try:
                pick.choice(ways)()
            except _REFUSED:  # what the library refuses to write is left
                continue


def _values(variable, pick):
    """Values that are not finite, huge, all equal, reversed, or one of them wrong."""
    values = np.array(variable[...])
    if not values.size:
        return
    flat = values.reshape(-1)
    odd = pick.choice((float("nan"), float("inf"), 1e30, -9999.0, 0.0, -1.0, 1e9))
    with np.errstate(all="ignore"):
        text = flat.dtype.kind == "S"
        wrong = b"?" if text else np.asarray(odd).astype(flat.dtype, casting="unsafe")
        match pick.randrange(4):
            case 0:
                flat[:] = wrong
            case 1:
                flat[pick.randrange(flat.size)] = wrong
            case 2:
                flat[:] = flat[::-1].copy()
            case _:
                flat[pick.randrange(flat.size)] = flat[0]
    variable[...] = flat.reshape(values.shape)


def damage_store(store, pick):
    """Remove, exchange or change files of a Zarr store or its metadata, in place."""
    for _ in range(pick.choice((1, 1, 2, 3))):
        files = sorted(path for path in store.rglob("*") if path.is_file())
        if not files:
            return
        marks = [path for path in files if path.name.startswith((".z", "zarr.json"))]
        victim = pick.choice(marks if marks and pick.random() < 0.6 else files)
        match pick.randrange(6):
            case 0:
                victim.unlink()
            case 1:
                victim.write_bytes(pick.choice(files).read_bytes())
            case 2:
                victim.unlink()
                victim.mkdir()
            case _ if victim in marks:
                victim.write_bytes(mutated("json", victim.read_bytes(), b"{}", pick))
            case _:
                victim.write_bytes(mutated("chunk", victim.read_bytes(), b"\0" * 99, pick))
