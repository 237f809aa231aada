"""The parts of a machine that ``dynahoi doctor`` looks at, one file each."""
