"""Result folders to one self-contained HTML page: tables, figures, paired comparisons, clips."""

from dynahoi_lerobot.report.page import render_report

__all__ = ["render_report"]
