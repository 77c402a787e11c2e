"""Text without passwords, keys, tokens, home directories and names of people.

How this works
--------------
Each rule of RULES takes out what looks like a secret by what stands around it, and leaves a word in its place that
breaks neither a quoted string nor a name: a robot file stays one. What was taken out is remembered, and `again` takes
it out wherever else it stands: the password of a configuration is also one in a log, and whose home directory there is
has a name. Rather too much goes than too little.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

GONE = "REDACTED"
SOMEBODY = "somebody"  # in place of a name: where one may stand, this may
SOMEWHERE = "somewhere"
HOME = "~"
LEAST = 4  # letters of what is looked for elsewhere too
# Names that tell nobody, and would take words out of every file.
ANYBODY = frozenset(
    {"admin", "debian", "drivegate", "nobody", "operator", "pi", "robot", "root", "ros", "ubuntu", "user", "localhost"}
)
_PLAIN = frozenset({"true", "false", "none", "null", GONE.lower(), SOMEBODY, SOMEWHERE})

_SECRET = (
    r"(?:pass(?:w(?:or)?[dt]|phrase|code)?s?|pwd|(?<![a-z0-9])pw(?![a-z0-9])|secret|token|credential|cookie|psk|usrpwd|authorization"
    r"|(?:api|private|access|secret|shared|session|host)[-_ ]?keys?|key_?(?:pem|base64)|pem|base64|certificate"
    r"|dictionary)"
)
_QUOTED = r"\"\"\"[\s\S]*?\"\"\"|'''[\s\S]*?'''|\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'"
# Of a quote that nobody closes the rest of the line; a pass phrase has several words, none of which is another's name.
_WORDS = rf"[^\s,;}}\]]+(?:[ \t]+(?!-|{GONE}|[\w.-]+[\"']?\s?[=:])[^\s,;}}\]\"']+)*"
_VALUE = rf"(?P<value>{_QUOTED}|\[[^\]]*\]|\{{[^}}]*\}}|[\"'][^\n]*|{_WORDS})"
# No repetition may be tried again at each of its own letters: a log has lines of any length.
_MORE = r"[\w.-]{0,40}"
_URL = r"[^\s\"'<>]{0,500}"


class _Rule(NamedTuple):
    """The group `value` of the pattern goes, if it `is_one`. `sure`: it is a secret, and one elsewhere too.

    No pattern takes much longer than in proportion to the text, whatever that is.
    """

    pattern: re.Pattern[str]
    sure: bool
    is_one: Callable[[str], bool]


def _rule(
    pattern: str, flags: int = re.IGNORECASE, *, sure: bool = True, is_one: Callable[[str], bool] = bool
) -> _Rule:
    return _Rule(re.compile(pattern, flags), sure, is_one)


def _is_mixed(word: str) -> bool:
    """Small and capital letters and digits, as no name has and no hexadecimal number."""
    return (
        re.search("[a-z]", word) is not None
        and re.search("[A-Z]", word) is not None
        and re.search("[0-9]", word) is not None
    )


RULES = (
    # Keys and certificates, also those of which a log has only the end or the beginning.
    _rule(r"(?P<value>-----BEGIN [^-\n]+-----[\s\S]*?(?:-----END [^-\n]+-----|\Z))"),
    _rule(r"(?<![A-Za-z0-9+/=])(?P<value>(?:[A-Za-z0-9+/=]{1,100}[ \t\r]?\n){0,80}-----END [^-\n]+-----)"),
    _rule(r"\A(?P<value>(?:[^\n]*\n)?(?:[^\n]*[A-Za-z0-9+/=]{20}[^\S\n]*\n)+[^\n]*-----END [^-\n]+-----)"),
    # user:password@ of a URL (tcp://), and of an endpoint (tcp/).
    _rule(rf"://(?P<value>{_URL})@"),
    _rule(rf"\b(?:tcp|udp|tls|quic|quic-datagram|wss?|unixsock-stream|serial|vsock)\\?/(?P<value>{_URL})@"),
    _rule(r"\b(?:bearer|basic|digest)\s+(?P<value>[^\s\"',;]+)"),
    # name = value, name: value, --name value, and "the name is value".
    _rule(rf"{_SECRET}{_MORE}[\"']?(?:\s+is)?\s*[:=]+>?\s*{_VALUE}"),
    _rule(rf"(?<!-)--[\w-]{{0,40}}{_SECRET}{_MORE}\s+{_VALUE}"),
    _rule(
        rf"(?<![a-z0-9])(?:password|passphrase|passcode|secret|token)\s+(?:(?:is|was)\s+)?(?![=:]){_VALUE}", sure=False
    ),
    # Tokens that are known by their look.
    _rule(r"\b(?P<value>(?:ghp|gho|ghs|ghr|glpat|xox[abprs]|sk|pk|rk)[-_][A-Za-z0-9_-]{10,}|github_pat_\w{10,})", 0),
    _rule(r"\b(?P<value>(?:AKIA|ASIA)[A-Z0-9]{16})\b", 0),
    _rule(r"\b(?P<value>eyJ[\w-]{5,}\.[\w-]+(?:\.[\w-]*)?)", 0),
    # Base64 of a key's length; a digest and a commit, which are hexadecimal, are none.
    _rule(r"(?P<value>[A-Za-z0-9+/_-]{40,}=*)", 0, is_one=_is_mixed),
    _rule(
        r"(?<![\w.+-])(?P<value>(?!drivegate|REDACTED)[\w.+-]+@[\w-]+(?:\.[\w-]+)*\.[a-z]{2,})"
    ),  # of mail; drivegate@moby.service is a unit
)
_HOMES = re.compile(r"(?:/var)?/(?:home|Users|export/home)/(?P<name>[^/\s\"'`:,;()\[\]<>]+)|/root(?![\w-])")
# Of Zenoh's own configuration: what is under such a name goes, whatever it is.
_STRUCTURED = re.compile(
    rf"{_SECRET}|user|cert|private|plugins?$|metadata|auth$|(?:^|_)key(?:$|_(?!exprs?))", re.IGNORECASE
)
# Goes where it stands, and may be an ordinary word elsewhere: somebody may be called as a source of commands is.
_IDENTITY = re.compile(r"user|common_name|metadata", re.IGNORECASE)


class Redaction:
    """For one archive. `people`: names of users, `homes`: their directories, `hosts`: names of computers."""

    def __init__(self, *, people: Iterable[str], homes: Iterable[str], hosts: Iterable[str]) -> None:
        self.times = 0
        self._found: set[str] = set()
        places = sorted({home.rstrip("/") for home in homes} - {"", "/"}, key=len, reverse=True)
        self._homes = [re.compile(rf"{re.escape(place)}(?![\w-])") for place in places]
        self._names: dict[str, str] = {}
        self.name(people, SOMEBODY)
        self.name(hosts, SOMEWHERE)

    def name(self, names: Iterable[str], instead: str) -> None:
        """These too are names, of which from now on something else is said."""
        self._names |= {name: instead for name in names if name and name.lower() not in ANYBODY | _PLAIN}

    def text(self, text: str) -> str:
        """The text without what any rule finds."""
        for rule in RULES:
            text = rule.pattern.sub(self._taken(rule), text)
        self.name({match["name"] for match in _HOMES.finditer(text) if match["name"]}, SOMEBODY)
        for pattern in (_HOMES, *self._homes):
            text = pattern.sub(self._counted(HOME), text)
        for name in sorted(self._names, key=len, reverse=True):
            text = _whole(name).sub(self._counted(self._names[name]), text)
        return text

    def again(self, text: str) -> str:
        """What was taken out somewhere, and stands here without anything that tells it."""
        for secret in sorted(self._found, key=len, reverse=True):
            if secret in text:
                text = text.replace(secret, GONE)
                self.times += 1
        return self.text(text)

    def left_in(self, data: bytes) -> bool:
        """Whether something of what was taken out stands in these bytes."""
        return any(secret.encode() in data for secret in self._found)

    def document(self, value: object, name: str = "") -> object:
        """A configuration in sections, as JSON has it: also without all that its names say is nobody's business."""
        if name and _STRUCTURED.search(name) and value not in (None, True, False, "", [], {}):
            self.times += 1
            if not _IDENTITY.search(name):
                self._remember(value)
            return GONE
        if isinstance(value, Mapping):
            return {self.text(str(key)): self.document(one, str(key)) for key, one in value.items()}
        if isinstance(value, list):
            return [self.document(one) for one in value]
        return self.text(value) if isinstance(value, str) else value

    def again_in(self, value: object) -> object:
        """`again` in every text of a document, which stays one."""
        if isinstance(value, Mapping):
            return {self.again(str(key)): self.again_in(one) for key, one in value.items()}
        if isinstance(value, list):
            return [self.again_in(one) for one in value]
        return self.again(value) if isinstance(value, str) else value

    def _taken(self, rule: _Rule) -> Callable[[re.Match[str]], str]:
        def instead(match: re.Match[str]) -> str:
            secret = match["value"]
            quote = next((mark for mark in ('"""', "'''", '"', "'") if secret.startswith(mark)), "")
            inner = secret[len(quote) : len(secret) - len(quote)] if quote and secret.endswith(quote) else secret
            if inner.lower() in _PLAIN or not rule.is_one(inner):
                return match[0]
            self.times += 1
            if rule.sure:
                self._remember(inner)
            begin, end = match.start("value") - match.start(), match.end("value") - match.start()
            return f"{match[0][:begin]}{quote}{GONE}{quote}{match[0][end:]}"

        return instead

    def _counted(self, instead: str) -> Callable[[re.Match[str]], str]:
        def count(_: re.Match[str]) -> str:
            self.times += 1
            return instead

        return count

    def _remember(self, value: object) -> None:
        """Of a URL's user:password also the password alone; of a key every line."""
        match value:
            case str():
                parts = {value, *value.splitlines(), *value.rpartition(":")[::2], *re.findall(_QUOTED, value)}
                parts |= {part.strip("\"' ,;-") for part in parts}
                self._found |= {part for part in parts if len(part) >= LEAST and part.lower() not in _PLAIN | ANYBODY}
            case Mapping():
                for name, one in value.items():
                    if not _IDENTITY.search(str(name)):
                        self._remember(one)
            case list():
                for one in value:
                    self._remember(one)


def _whole(name: str) -> re.Pattern[str]:
    """A name where it is not a part of a longer word."""
    return re.compile(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])")
