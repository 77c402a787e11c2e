"""What the pages say of commands, held against the command line: whole commands in blocks, and mentions in the text."""

import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import typer
from typer.core import TyperCommand
from typer.exceptions import TyperException

from tests.docs.generated import COMMAND, leaves
from tests.docs.pages import ROOT, Block, blocks, prose

LEAVES: Final = {leaf.words: leaf.command for leaf in leaves()}
GROUPS: Final = {words[:-1] for words in LEAVES if len(words) > 1}
OF_ITSELF: Final = ("--version", "--help")
_BEFORE: Final = ("sudo", "&&", ";", "|", "!", "timeout")
_BEHIND: Final = re.compile(r"[&|;>]|2>")
_OF_A_ROBOT: Final = re.compile(
    r"\b(sudo|apt-get|systemctl|udevadm|journalctl)\b|/etc/|deploy/\S+\.(?:sh|py)|^ *git ", re.MULTILINE
)
_LEFT_OUT: Final = re.compile(r"[A-Z]{2,}|…|\.\.\.|\[|\|")  # placeholders of a mention


def commands(block: Block) -> Iterator[list[str]]:
    """The words of each `drivegate` in a block of the shell."""
    for line in block.text.replace("\\\n", " ").splitlines():
        try:
            words = shlex.split(line, comments=True)
        except ValueError:  # a quote that goes on in the next line
            words = line.split()
        for at, word in enumerate(words):
            if word == COMMAND and (at == 0 or words[at - 1] in _BEFORE):
                rest = words[at + 1 :]
                yield rest[: next((end for end, one in enumerate(rest) if _BEHIND.match(one)), len(rest))]


def wrong(words: Sequence[str]) -> str | None:
    """Why the command line would refuse this command, without running it."""
    if not words or words[0] in OF_ITSELF:
        return None
    found = _leaf(words)
    if found is None:
        return f"no such command: {COMMAND} {' '.join(words)}"
    command, rest = found
    try:
        command.make_context(" ".join(words), list(rest))
    except typer.Exit:
        return None  # --help
    except TyperException as error:
        return f"{COMMAND} {' '.join(words)}: {error}"
    return None


def mentioned_wrongly(text: str) -> Iterator[str]:
    """What the text of a page calls a command, or an option of one, that is none."""
    for mention in re.findall(rf"`{COMMAND} ([^`\n]+)`", prose(text)):
        words = mention.split()
        found = _leaf(words)
        if words[0] in OF_ITSELF or _LEFT_OUT.match(words[0]):
            continue
        if tuple(words[:1]) in GROUPS and (len(words) == 1 or _LEFT_OUT.match(words[1])):
            continue
        if found is None:
            yield f"no such command: `{COMMAND} {mention}`"
            continue
        command, rest = found
        known = {name for one in command.params for name in (*one.opts, *one.secondary_opts)} | {"--help"}
        told = [word.strip("[]").split("=")[0] for word in rest if word.strip("[]").startswith("--")]
        yield from (f"`{COMMAND} {mention}`: no option {option}" for option in told if option not in known)


def covered_by_nothing(block: Block) -> str | None:
    """A marker that names no test or lane there is."""
    named = block.markers.get("covered")
    if named is None:
        return None
    file, _, test = named.partition("::")
    path: Path = ROOT / file
    if not path.is_file():
        return f"covered by {named}: there is no such file"
    if test and not re.search(rf"^def {re.escape(test)}\(", path.read_text(encoding="utf-8"), re.MULTILINE):
        return f"covered by {named}: there is no such test"
    return None


def faults(text: str) -> Iterator[str]:
    """Everything that is wrong with the commands of a page."""
    for block in blocks(text):
        lost = covered_by_nothing(block)
        if lost is not None:
            yield f"line {block.line}: {lost}"
        if block.runs and (found := _OF_A_ROBOT.search(block.text)):
            yield f"line {block.line}: {found[0].strip()} changes a computer: say by what the block is covered"
        if block.language == "sh":
            said = (wrong(words) for words in commands(block))
            yield from (f"line {block.line}: {one}" for one in said if one is not None)
    yield from mentioned_wrongly(text)


def _leaf(words: Sequence[str]) -> tuple[TyperCommand, Sequence[str]] | None:
    for length in (2, 1):
        command = LEAVES.get(tuple(words[:length]))
        if command is not None:
            return command, words[length:]
    return None
