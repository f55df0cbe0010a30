"""``prbench help``: what there is, and how a shell completes it."""

from __future__ import annotations

import click

from prbench.cli.commands import command

EXIT_CODES = {
    0: "success",
    1: "the command worked, and what it compared or examined differs or is wrong (diff, doctor, a row of Table 2);"
    " any problem without a code of its own",
    2: "the command line asks for something that does not exist or does not fit together",
    3: "a file or recording is missing, damaged or unreadable; a build finished without some of its recordings",
    4: "a table is missing, empty, of an unknown version, or inconsistent",
    5: "a method is unknown, cannot be loaded, or broke the adapter contract",
    6: "predictions do not match the table that they are scored on",
    7: "a run folder belongs to other inputs, or is damaged",
    8: "writing failed: disk full, folder not writable, a file in the way, or an earlier result would lose recordings",
    9: "an optional package is missing or cannot be loaded; the message holds the `pip install` line",
    10: "a licence does not let recorded motion be passed on",
    11: "a training folder belongs to another training, or the training cannot go on",
    12: "the machine's memory does not suffice for one item of the work",
    13: "a cluster cannot be reached, one of its nodes is unfit for the work, or none is left",
    14: "a shard is missing, there twice, of another build or run, unfinished or damaged",
    130: "interrupted by Ctrl-C (128 + the signal's number); finished parts are kept where the command resumes",
    143: "asked to stop by SIGTERM (128 + the signal's number); a training has saved what it had, other work keeps"
    " finished parts",
}
"""Every exit code of the program, and what it means."""
_SHELLS = {
    "bash": 'eval "$(prbench help completion bash)"    # in ~/.bashrc',
    "zsh": 'eval "$(prbench help completion zsh)"     # in ~/.zshrc',
    "fish": "prbench help completion fish > ~/.config/fish/completions/prbench.fish",
}


@command("help", example="prbench help leaderboard compare")
@click.argument("topic", nargs=-1, metavar="[COMMAND...]")
@click.pass_context
def help(ctx: click.Context, topic: tuple[str, ...]) -> int:
    """Explain a command, or the exit codes.

    `prbench help exit-codes` lists the exit codes of all commands. `prbench help completion bash` (or zsh, fish) prints
    the script by which a shell completes commands, options and their values (docs/command-line.md).
    """
    if topic == ("exit-codes",):
        from prbench.cli.terminal import print_table

        rows = [(str(code), meaning) for code, meaning in EXIT_CODES.items()]
        print_table("exit codes", ("code", "meaning"), rows, numbers=(0,))
        return 0
    if topic[:1] == ("completion",):
        from click.shell_completion import get_completion_class

        kind = get_completion_class(topic[1]) if len(topic) == 2 else None
        if kind is None:
            lines = "\n".join(f"  {shell:<5} {line}" for shell, line in _SHELLS.items())
            raise click.UsageError(f"help completion: name one shell.\n{lines}\n", ctx)
        print(kind(ctx.find_root().command, {}, "prbench", "_PRBENCH_COMPLETE").source())
        return 0
    found: click.Command = ctx.find_root().command
    context = ctx.find_root()
    for word in topic:
        if not isinstance(found, click.Group):
            raise click.UsageError(f"'{context.command_path}' has no commands of its own, such as '{word}'.", context)
        _, command_found, _ = found.resolve_command(context, [word])  # refuses an unknown one, names the nearest
        assert command_found is not None
        found = command_found
        context = click.Context(found, info_name=word, parent=context)
    print(found.get_help(context))
    return 0
