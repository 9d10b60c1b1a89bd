"""Pages of the site that are made from other files, so that nothing is written twice.

The start page is README.md, changelog and licence come from the root, the reference of the command line from its
parser, the list of experiments from their folder.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
FROM_ROOT = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """List every experiment below the index of experiments."""
    pages = sorted(path.name for path in (ROOT / "docs" / "experiments").glob("0*.md"))
    for entry in config.nav or []:
        if "Experiments" in entry:
            entry["Experiments"] = ["experiments/index.md", *(f"experiments/{page}" for page in pages)]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside ``docs/`` or in no file at all."""
    for source, page in FROM_ROOT.items():
        text = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](").replace("](./docs/", "](")
        files.append(File.generated(config, page, content=_linked(text, "")))
    files.append(File.generated(config, "LICENSE", content=(ROOT / "LICENSE").read_text(encoding="utf-8")))
    files.append(File.generated(config, "command_line.md", content=command_line()))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Pages of ``docs/`` refer to files of the root as they lie in the repository."""
    return _linked(markdown, "../")


def _linked(text: str, prefix: str) -> str:
    for source, page in FROM_ROOT.items():
        text = text.replace(f"]({prefix}{source}", f"]({page}")
    return text


def command_line() -> str:
    """The reference of all commands as Markdown."""
    sys.path.insert(0, str(ROOT))
    from headless.cli import make_parser

    parser = make_parser()
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    text = [
        "# Command line\n",
        "`iris COMMAND …` after `pip install .`, `python headless/run.py COMMAND …` in the repository and in Blender. "
        "Exit codes: 0 done, 1 failed, 2 usage, 3 bad input, 4 solver environment missing, 130 cancelled.\n",
    ]
    for name, command in commands.choices.items():
        text.append(f"## {name}\n\n{_sentence(command.description or '')}\n\n```\n{_usage(command)}\n```\n")
        rows = [_row(action) for action in command._actions if not isinstance(action, argparse._HelpAction)]
        text.append("\n".join(["| argument | default | meaning |", "|---|---|---|", *rows, ""]))
    return "\n".join(text)


def _usage(command: argparse.ArgumentParser) -> str:
    _, _, after = " ".join(command.format_usage().split()).partition(".py ")
    return f"iris {after}" if after else " ".join(command.format_usage().split()).removeprefix("usage: ")


def _row(action: argparse.Action) -> str:
    takes = action.metavar or ("|".join(action.choices) if action.choices else action.dest.upper())
    value = "" if action.nargs == 0 else f" {takes}"
    name = ", ".join(action.option_strings) + value if action.option_strings else str(action.metavar or action.dest)
    shown = action.default not in (None, False, argparse.SUPPRESS)
    default = "x".join(map(str, action.default)) if isinstance(action.default, tuple) else str(action.default)
    required = "required" if action.required else ""
    cells = (f"`{name}`", f"`{default}`" if shown else required, (action.help or "").replace("%%", "%"))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."
