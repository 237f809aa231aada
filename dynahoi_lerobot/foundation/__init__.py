"""What every room uses: conventions, registries, rotations, command-line lists."""
