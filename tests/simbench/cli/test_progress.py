"""What is told of a long command where nobody watches."""

from simbench.cli.progress import frame_progress, lines, run_progress


def test_a_log_gets_a_line_a_minute_with_the_time_left(capsys):
    clock = iter([0, 1, 50, 80, 100, 141, 300])        # the first when it begins
    show = lines("tiny", 10, "runs", lambda: next(clock))
    for done in (2, 3, 4, 5, 6, 10):
        show(done)
    assert capsys.readouterr().err == ("tiny: 4 of 10 runs, 0:01:20, left 0:04:00\n"
                                       "tiny: 6 of 10 runs, 0:02:21, left 0:02:21\n")


def test_what_is_quick_says_nothing(capsys):
    with frame_progress("tiny", 2) as advance:
        advance()
        advance()
    with run_progress("tiny", 2) as show:
        show(2)
    assert capsys.readouterr() == ("", "")
