"""Spoiling texts and bytes by chance, the same for the same seed."""

import random

_VALUES = (
    *(".nan", ".inf", "-.inf", "-1", "0", "1e999", "1e-320", "9" * 40, "0x1F", "1_000", "yes", "null", "~"),
    *("''", '"', "[]", "{}", "[1, 2", "{a: ", "[[[[]]]]", "!!python/object:os.system", "&a [*a]", "*b"),
    *("../../..", "/dev/zero", "C:\\\\x", "cam1", "é\u0000", "\ufeff", "12:30:00", "2020-01-01", "{frame}"),
    *("*", "**/*", "-", "|", ">", "%", "@", "`", "<<: *x", "9" * 400, "a" * 3000, "{frame:99999d}"),
)


def spoil_text(text: str, chance: random.Random) -> bytes:
    """One to four mistakes in a text of lines ``key: value``."""
    lines = text.splitlines()
    for _ in range(chance.choice([1, 1, 2, 4])):
        chance.choice(_KINDS)(lines, chance)
    out = "\n".join(lines).encode("utf-8", "surrogatepass") + b"\n"
    return spoil_bytes(out, chance) if chance.random() < 0.1 else out


def _drop(lines, chance):
    if len(lines) > 1:
        del lines[chance.randrange(len(lines))]


def _double(lines, chance):
    k = chance.randrange(len(lines))
    lines.insert(chance.randrange(len(lines)), lines[k])


def _value(lines, chance):
    k = chance.randrange(len(lines))
    before, colon, _ = lines[k].partition(":")
    lines[k] = before + (colon or ",") + " " + chance.choice(_VALUES)


def _inside(lines, chance):
    """Another number or word somewhere inside a line."""
    k = chance.randrange(len(lines))
    words = lines[k].replace(",", " , ").replace("}", " }").replace("]", " ]").split(" ")
    words[chance.randrange(len(words))] = chance.choice(_VALUES)
    lines[k] = " ".join(words)


def _letter(lines, chance):
    k = chance.randrange(len(lines))
    at = chance.randrange(len(lines[k]) + 1)
    lines[k] = (
        lines[k][:at] + chance.choice("abz09:;,.{}[]\"'#&*!|>%@`\t -_\u00e9\u2028") + lines[k][at + 1 :]
    )


def _indent(lines, chance):
    k = chance.randrange(len(lines))
    lines[k] = chance.choice(["", " ", "    ", "\t"]) + lines[k].lstrip()


def _swap(lines, chance):
    a, b = chance.randrange(len(lines)), chance.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]


def _cut(lines, chance):
    k = chance.randrange(len(lines))
    lines[k] = lines[k][: chance.randrange(len(lines[k]) + 1)]
    del lines[k + 1 + chance.randrange(len(lines) - k) :]


_KINDS = (_drop, _double, _value, _value, _inside, _inside, _letter, _letter, _indent, _swap, _cut)


def spoil_bytes(data: bytes, chance: random.Random) -> bytes:
    """Bytes changed, cut off, or put in."""
    out = bytearray(data)
    kind = chance.randrange(4)
    if kind == 0:
        return bytes(out[: chance.randrange(len(out))])
    for _ in range(chance.choice([1, 3, 30])):
        at = chance.randrange(len(out))
        if kind == 1:
            out[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            out[chance.randrange(min(64, len(out)))] = chance.randrange(256)  # the header
        else:
            out[at:at] = bytes(chance.randrange(256) for _ in range(chance.randint(1, 9)))
    return bytes(out)
