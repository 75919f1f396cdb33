"""Checks that built pages load nothing from elsewhere: `python docs/site/offline.py build/docs`.

Links may lead anywhere. Scripts, styles, pictures, fonts and frames must come with the pages.
"""

import re
import sys
from pathlib import Path

LOADING = (
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\bsrc\s*=\s*["']((?:https?:)?//[^"']+)""",
    r"""<link\b(?![^>]*rel=["'](?:canonical|author|license)["'])[^>]*?\bhref\s*=\s*["']((?:https?:)?//[^"']+)""",
    r"""@import\s+(?:url\()?["']?((?:https?:)?//[^"');\s]+)""",
    r"""url\(\s*["']?((?:https?:)?//[^"')\s]+)""",
)
"""What makes a browser fetch an address, in pages and in style sheets."""


def loaded(folder: Path) -> list[str]:
    """`file: address` for all that the pages and styles in a folder would fetch from elsewhere."""
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".html", ".css"))
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    return [
        f"{path.relative_to(folder)}: {address}"
        for path, text in texts.items()
        for pattern in LOADING
        for address in re.findall(pattern, text)
    ]


if __name__ == "__main__":
    found = loaded(Path(sys.argv[1]))
    if found:
        sys.exit("\n".join(["error: the pages load from elsewhere", *found]))
