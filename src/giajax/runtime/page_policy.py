"""Content security policy of pages: run their own scripts and load nothing from elsewhere."""

import base64
import hashlib
import re

_SCRIPT = re.compile(
    rb"<script(?![^>]*application/json)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE
)
_FIRST = re.compile(rb"<(?:style|script|link)\b", re.IGNORECASE)


VISER = "'self' 'unsafe-inline' 'unsafe-eval' blob:"
"""Script sources of the viser page, which unpacks itself and so has no fixed checksum."""


def policy(scripts: str, connect: str = "data: blob:") -> str:
    """Return the header of a content security policy for given sources of scripts and of data."""
    return (
        f"default-src 'none'; script-src {scripts}; connect-src {connect}; "
        "style-src 'unsafe-inline'; img-src 'self' data: blob:; font-src data:; "
        "worker-src blob: data:; frame-src 'self'; base-uri 'none'; form-action 'none'"
    )


def own_scripts(page: bytes) -> str:
    """Return policy sources that permit the inline scripts of a page and no others."""
    sums = (hashlib.sha256(found[1]).digest() for found in _SCRIPT.finditer(page))
    found = dict.fromkeys(f"'sha256-{base64.b64encode(each).decode()}'" for each in sums)
    return " ".join(found) or "'none'"


def with_policy(page: bytes, scripts: str | None = None, connect: str = "data: blob:") -> bytes:
    """Return an HTML page with a policy in its head; by default it may run its own scripts."""
    said = policy(own_scripts(page) if scripts is None else scripts, connect)
    meta = f'<meta http-equiv="Content-Security-Policy" content="{said}">\n'.encode()
    found, count = _FIRST.subn(lambda first: meta + first[0], page, count=1)
    assert count, "internal error: the page has no style or script that the policy could precede"
    return found
