"""`hubodo completion`: print the shell completion script."""

import argparse

SHELLS = ("bash", "zsh", "fish")
EXAMPLE = """eval "$(hubodo completion bash)"                              # in ~/.bashrc
  eval "$(hubodo completion zsh)"                               # in ~/.zshrc, after compinit
  hubodo completion fish > ~/.config/fish/completions/hubodo.fish"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo completion`."""
    parser.add_argument(
        "shell",
        metavar="SHELL",
        choices=SHELLS,
        help=f"the shell that the script is for: {', '.join(SHELLS)}",
    )


def run(args: argparse.Namespace) -> None:
    """Print the completion script for the chosen shell to standard output."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["hubodo"], shell=args.shell).strip())
