"""A paper's tables: its numbers as printed, beside ours on synthetic counterparts."""
