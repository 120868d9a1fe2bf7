"""The table of commands in docs/reference/command-line.md, from the command line's own parser."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping

from ci.docs import markdown
from ci.folders import PROJECT
from robotkube.cli.main import add_access_arguments
from robotkube.cli.main import parser as grammar
from robotkube.cli.output import FORMATS

PAGE = PROJECT / "docs" / "reference" / "command-line.md"
BEGIN = "<!-- Written by `make reference` from the parser; a test says when it is not current. -->"
END = "<!-- End of what is written by `make reference`. -->"


def page(text: str) -> str:
    """`text` of the page with everything between the two marks written anew; ValueError when a mark is missing."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{PAGE.name}: needs both marks, {BEGIN} and {END}")
    return markdown.wrapped(f"{before}{BEGIN}\n\n" + "\n".join(lines()) + f"\n{END}{after}")


def lines() -> Iterator[str]:
    """The options of all commands, then every command with its own."""
    yield from ["### Options of every command", "", *_table(common())]
    for name, parser in commands().items():
        yield from [
            f"### robotkube {name}",
            "",
            f"{_sentence(parser.description or '')}",
            "",
            f"    {_usage(parser)}",
            "",
        ]
        own = [action for action in parser._actions if not set(action.option_strings) & _common_words()]
        if own:
            yield from _table(own)


def commands() -> Mapping[str, argparse.ArgumentParser]:
    """`<noun> <verb>` (or the noun alone) -> its parser, in the order of the help."""
    parsers: dict[str, argparse.ArgumentParser] = {}
    for noun, parser in _choices(grammar()).items():
        verbs = _choices(parser)
        parsers |= {f"{noun} {verb}": inner for verb, inner in verbs.items()} if verbs else {noun: parser}
    return parsers


def common() -> list[argparse.Action]:
    """What every command takes."""
    parser = argparse.ArgumentParser(add_help=False)
    add_access_arguments(parser)
    parser.add_argument("-o", "--output", choices=FORMATS, default="table", help="form of the data on stdout")
    return parser._actions


def _common_words() -> set[str]:
    return {"-h", *(word for action in common() for word in action.option_strings)}


def _choices(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return actions[0].choices if actions else {}


def _usage(parser: argparse.ArgumentParser) -> str:
    """What must be given; options stand in the table."""
    needed = [action for action in parser._actions if action.required or not action.option_strings]
    words = [_words(action) if action.required else f"[{_words(action)}]" for action in needed]
    return " ".join([parser.prog, *words])


def _words(action: argparse.Action) -> str:
    value = action.metavar if isinstance(action.metavar, str) else None
    if not action.option_strings:
        return (value or action.dest.upper()) + ("..." if action.nargs in ("*", "+") else "")
    if action.nargs == 0:
        return ", ".join(action.option_strings)
    value = value or ("|".join(map(str, action.choices)) if action.choices else action.dest.upper())
    return f"{', '.join(action.option_strings)} {value}"


def _table(actions: list[argparse.Action]) -> Iterator[str]:
    yield from ["| argument | meaning |", "| --- | --- |"]
    for action in actions:
        default = f" (default: {action.default})" if _shows_default(action) else ""
        meaning = f"{action.help or ''}{default}".replace("<", "&lt;")
        cells = [text.replace("|", "\\|") for text in (f"`{_words(action)}`", meaning)]
        yield f"| {' | '.join(cells)} |"
    yield ""


def _shows_default(action: argparse.Action) -> bool:
    stated = action.default not in (None, "", False, argparse.SUPPRESS, [])
    return stated and "default" not in (action.help or "")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
