"""Words of a page can be read by light, by dark and on paper: WCAG 2's contrast of 4.5, level AA."""

from __future__ import annotations

import re

import pytest

from limbcli.config import templates_folder

ON_PAPER, MOODS = ("paper", "sheet"), ("fine", "warning", "failed", "missing")
PAIRS = [(word, back) for word in ("ink", "soft", "accent") for back in ON_PAPER]
PAIRS += [(mood, "sheet") for mood in MOODS] + [(mood, f"{mood}-back") for mood in MOODS]
PAIRS += [(word, f"{mood}-back") for word in ("ink", "soft") for mood in MOODS]


def colours(css: str, *media: str) -> dict[str, str]:
    """Those of `:root`, those of each media query above them."""
    roots = [css.split("@media", 1)[0], *(css.split(f"@media {each}", 1)[1] for each in media)]
    blocks = [re.search(r":root \{(.*?)\}", each, flags=re.DOTALL).group(1) for each in roots]
    return {name: value for block in blocks for name, value in re.findall(r"--([\w-]+): (#\w+)", block)}


def luminance(colour: str) -> float:
    digits = colour[1:] if len(colour) == 7 else "".join(2 * each for each in colour[1:])
    parts = [int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    linear = [each / 12.92 if each <= 0.04045 else ((each + 0.055) / 1.055) ** 2.4 for each in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize(
    "media", [(), ("(prefers-color-scheme: dark)",), ("print",), ("(prefers-color-scheme: dark)", "print")]
)
def test_words_stand_out_from_what_is_behind_them(media):
    own = colours((templates_folder() / "report/style.css").read_text(encoding="utf-8"), *media)
    for word, back in PAIRS:
        light, dark = sorted((luminance(own[word]), luminance(own[back])), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5, f"{word} on {back}"
