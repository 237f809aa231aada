"""The checks that ``dynahoi verify`` runs: one file per check, found by its decorator."""
