"""One page about a run: rates, failures, groups, episodes with pictures, timings, provenance."""

from evaluator.report.writing import PAGE_NAME, ReportOptions, WrittenReport, write_report

__all__ = ["PAGE_NAME", "ReportOptions", "WrittenReport", "write_report"]
