"""One self-contained HTML page about a run, and the table of errors that heads it."""
