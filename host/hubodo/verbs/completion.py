"""`hubodo completion`: the script with which a shell completes verbs, options, ports, nodes and files."""

import argparse

SHELLS = ("bash", "zsh", "fish")
EXAMPLE = """eval "$(hubodo completion bash)"                              # in ~/.bashrc
  eval "$(hubodo completion zsh)"                               # in ~/.zshrc, after compinit
  hubodo completion fish > ~/.config/fish/completions/hubodo.fish"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which shell."""
    parser.add_argument("shell", choices=SHELLS, help="for which shell")


def run(args: argparse.Namespace) -> None:
    """Prints the script."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["hubodo"], shell=args.shell).strip())
