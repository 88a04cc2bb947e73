"""Files as bytes, mangled."""

from __future__ import annotations

import random

# What editors, transfers and broken disks leave in a file, and what TOML makes something of.
PIECES = [
    b"\x00",
    b"\xff",
    b"\xc3",
    b"\xed\xa0\x80",
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\r",
    b"\n",
    b"\t",
    b"\x1b[2J",
    b"\x7f",
    b'"',
    b"'",
    b'"""',
    b"[",
    b"]",
    b"[[",
    b"]]",
    b"{",
    b"}",
    b"=",
    b",",
    b".",
    b"#",
    b"\\",
    b"\\u0000",
    b"\\U00110000",
    b"nan",
    b"-",
    b"+inf",
    b"_",
    b"e9999",
    b"9" * 5000,
    b"[" * 3000,
    b"{a=" * 3000,
    b"a." * 3000,
    b"x = 1\n",
    b"[x]\n",
    b"[[gimbal]]\n",
    b"[root]\n",
    "\u202e".encode(),
    "\u2028".encode(),
    "\ud7ff\ue000\U0010ffff".encode(),
]


def mangled(text: bytes, how: random.Random) -> bytes:
    """Return a file with one to four things done to it."""
    for _ in range(how.choice((1, 1, 1, 2, 4))):
        place, length = how.randrange(len(text) + 1), how.choice((1, 1, 2, 5, 40, 400))
        lines = text.split(b"\n")
        line = how.randrange(len(lines))
        match how.randrange(10):
            case 0:
                text = text[:place] + bytes([how.randrange(256)]) + text[place + 1 :]
            case 1:
                text = text[:place] + text[place + length :]
            case 2 | 3:
                text = text[:place] + how.choice(PIECES) + text[place:]
            case 4:
                text = text[:place]
            case 5:
                text = b"\n".join([*lines[: line + 1], *lines[line : line + length], *lines[line + 1 :]])
            case 6:
                text = b"\n".join([*lines[:line], *lines[line + 1 :]])
            case 7:
                other = how.randrange(len(lines))
                lines[line], lines[other] = lines[other], lines[line]
                text = b"\n".join(lines)
            case 8:
                text = bytes(byte ^ (1 << how.randrange(8)) if how.random() < 0.003 else byte for byte in text)
            case 9:
                from_, to = how.choice([(b"=", b":"), (b"[[", b"["), (b"[", b"[["), (b".", b","), (b"\n", b"\r\n")])
                text = text.replace(from_, to, how.choice((1, 1000)))
    return text
