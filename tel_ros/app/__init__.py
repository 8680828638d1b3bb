"""The command line: bring-up, practice runs and reports."""
