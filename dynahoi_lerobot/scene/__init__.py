"""The compiled MuJoCo model that every episode shares, and the per-world fields that turn it into one episode."""
