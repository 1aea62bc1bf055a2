"""Spoil texts and bytes at random, reproducibly."""

import random

_VALUES = (
    *(".nan", ".inf", "-.inf", "-1", "0", "1e999", "1e-320", "9" * 40, "0x1F", "1_000", "yes", "null", "~"),
    *("''", '"', "[]", "{}", "[1, 2", "{a: ", "[[[[]]]]", "!!python/object:os.system", "&a [*a]", "*b"),
    *("../../..", "/dev/zero", "C:\\\\x", "cam1", "é\u0000", "\ufeff", "12:30:00", "2020-01-01", "{frame}"),
    *("*", "**/*", "-", "|", ">", "%", "@", "`", "<<: *x", "9" * 400, "a" * 3000, "{frame:99999d}"),
)
_LETTERS = "abz09:;,.{}[]\"'#&*!|>%@`\t -_\u00e9\u2028"


def spoil_text(text: str, chance: random.Random) -> bytes:
    """Return a text of lines ``key: value`` with one to four mistakes."""
    lines = text.splitlines()
    for _ in range(chance.choice([1, 1, 2, 4])):
        k = chance.randrange(len(lines))
        line, at = lines[k], chance.randrange(len(lines[k]) + 1)
        before, colon, _ = line.partition(":")
        words = line.replace(",", " , ").replace("}", " }").replace("]", " ]").split(" ")
        words[chance.randrange(len(words))] = chance.choice(_VALUES)
        lines[k : k + 1] = chance.choice(
            [
                [],  # dropped
                [line, chance.choice(lines)],  # another one again
                [f"{before}{colon or ','} {chance.choice(_VALUES)}"],
                [" ".join(words)],  # another number or word inside
                [line[:at] + chance.choice(_LETTERS) + line[at + 1 :]],
                [chance.choice(["", " ", "    ", "\t"]) + line.lstrip()],
                [line[:at]],
            ]
        )
        lines = lines or [""]
    out = "\n".join(lines).encode("utf-8", "surrogatepass") + b"\n"
    return spoil_bytes(out, chance) if chance.random() < 0.1 else out


def spoil_bytes(data: bytes, chance: random.Random) -> bytes:
    """Return bytes that are changed, truncated or inserted into."""
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
