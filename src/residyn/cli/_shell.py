"""What all commands share: exit statuses, words, progress, JAX's settings."""

import _thread
import contextlib
import errno
import gc
import multiprocessing
import os
import signal
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import typer

from ..errors import InputError
from ..runtime.settings import set_up

if TYPE_CHECKING:
    from rich.console import Console

DONE, NO_NUMBERS, BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141
TRACEBACK = "RESIDYN_TRACEBACK"
_WIDTH = 80  # columns of a terminal that does not say how many it has
_AGAIN = 0.1  # s after which memory is freed and a Ctrl-C that was lost in that comes again
_WHOLE: Any = {"break_on_hyphens": False, "break_long_words": False}

# The class of all complaints about the command line, which typer itself does not name.
UsageError: Any = typer.BadParameter.__bases__[0]


class NoNumbers(Exception):
    """The input was fine, and still the numbers could not be had: one line that says why."""

    def __init__(self, line: str, status: int = NO_NUMBERS):
        super().__init__(line)
        self.status = status


def run(app: typer.Typer, args: Sequence[str] | None) -> int:
    """Run a command line; every way it can end is one exit status and at most one line."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):
            # A terminal that cannot show a letter gets a question mark, not a crash.
            stream.reconfigure(errors="replace")  # pyrefly: ignore[missing-attribute]
    command = typer.main.get_command(app)
    usual, sys.unraisablehook = sys.unraisablehook, _interrupt_again
    try:
        words = list(sys.argv[1:] if args is None else args)
        try:
            with command.make_context("residyn", words) as context:
                command.invoke(context)
            status = DONE
        except typer.Exit as end:
            status = end.exit_code
        except NoNumbers as error:
            status = complain(str(error), error.status)
        sys.stdout.flush()
        return status
    except (KeyboardInterrupt, typer.Abort):
        return complain("interrupted", INTERRUPTED)
    except BrokenPipeError:
        _hang_up()
        return BROKEN_PIPE
    except OSError as error:  # of files it is an InputError
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            return _unexpected(error)
        _hang_up()
        return complain(f"standard output: cannot be written ({error.strerror})", BAD_INPUT)
    except UsageError as error:
        return complain(_usage(error), BAD_INPUT)
    except InputError as error:
        return complain(str(error), BAD_INPUT)
    except Exception as error:
        return _unexpected(error)
    finally:
        sys.unraisablehook = usual


def complain(line: str, status: int) -> int:
    """Say one line on standard error."""
    with contextlib.suppress(OSError):
        tell(line)
    return status


def tell(line: str) -> None:
    """One line on standard error, wrapped between words where that is a terminal."""
    line = f"residyn: {line}"
    if sys.stderr.isatty():
        width = os.get_terminal_size(sys.stderr.fileno()).columns or _WIDTH
        line = textwrap.fill(line, width, subsequent_indent="  ", **_WHOLE)
    print(line, file=sys.stderr, flush=True)


def indented(out: "Console", words: str) -> None:
    """A paragraph two blanks in, wrapped at the width of `out`; no blanks behind its lines."""
    for line in textwrap.wrap(words, out.width - 2, **_WHOLE):
        out.print(f"  {line}", soft_wrap=True)


def work_begins() -> None:
    """From here on Ctrl-C is an exception again: whoever computes may end well, with what it has.
    And garbage is collected again, but not looked for among all that packages have made (see
    `residyn.__main__`)."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    now = signal.getsignal(signal.SIGINT)
    if getattr(now, "__module__", None) in ("residyn.__main__", "__main__"):
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupt_again(lost: "sys.UnraisableHookArgs") -> None:
    """Ctrl-C while Python frees memory is an exception that nobody can catch: it comes again, from
    a thread, for here it would be lost too."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        again = threading.Timer(_AGAIN, _interrupt)
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(lost)


def _interrupt() -> None:
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:  # which wakes whoever waits, too
        os.kill(os.getpid(), signal.SIGINT)


def _unexpected(error: Exception) -> int:
    """A mistake of ours, or more asked for than the memory holds."""
    if os.environ.get(TRACEBACK):
        raise error
    what = f"{type(error).__name__}: {error}".splitlines()[0]
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in what:  # NumPy's words, and XLA's
        return complain(f"there is not enough memory: {str(error).splitlines()[0]}", NO_NUMBERS)
    return complain(
        f"this should not have happened, {what} (set {TRACEBACK}=1 to see where)", NO_NUMBERS
    )


def _hang_up() -> None:
    """Nothing more goes to standard output: Python flushes it at exit, and would complain then."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _usage(error: Any) -> str:
    line = " ".join(error.format_message().split()).rstrip(".")
    path = error.ctx.command_path if error.ctx is not None else "residyn"
    line = line.replace(". Did you mean", "; did you mean")
    return f"{line[:1].lower()}{line[1:]}{'' if line.endswith('?') else ';'} see {path} --help"


def console(*, stderr: bool = False) -> "Console":
    """Where words for people go. Not a terminal: no colours, and lines as long as they are."""
    from rich.console import Console

    class Open(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # rich would end with a status of its own

    out = Open(stderr=stderr, highlight=False, markup=False, emoji=False)
    if not out.is_terminal:
        out.width = 1000
    return out


@contextlib.contextmanager
def progress(first: str = "starting") -> Iterator[Callable[[str], None]]:
    """A line on standard error that says what is being done and for how long, gone afterwards;
    words that know what `share` (0 to 1) is done move a bar."""
    out = console(stderr=True)
    if not out.is_terminal:
        yield lambda words: None
        return
    from rich import progress as rich
    from rich.table import Column
    from rich.text import Text

    class Bar(rich.ProgressColumn):
        def render(self, task):
            return Text("") if task.total is None else rich.BarColumn(24).render(task)

    # Of a line that is too long the words are cut: spinner and clock stay.
    cut = Column(no_wrap=True, ratio=1)
    words = rich.TextColumn("{task.description}", markup=False, table_column=cut)
    columns = (rich.SpinnerColumn(), words, Bar(), rich.TimeElapsedColumn())
    with rich.Progress(*columns, console=out, transient=True, expand=True) as bar:
        task = bar.add_task(first, total=None)

        def say(words: str) -> None:
            share = getattr(words, "share", None)
            bar.tasks[0].total = None if share is None else 1.0
            bar.update(task, description=words, completed=share or 0.0)

        yield say


def set_up_jax(cache: bool) -> None:
    """JAX as a command wants it; importing the package sets nothing."""
    # A recording is a chain of small steps, which is what a CPU does best; the user may disagree.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        set_up(cache=cache)
    if multiprocessing.parent_process() is None:  # else it has said so
        for each in said:
            tell(str(each.message))
