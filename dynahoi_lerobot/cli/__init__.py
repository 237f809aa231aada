"""The command line: ``dynahoi <command>``."""
