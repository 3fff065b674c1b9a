"""One page about a run: rates, failures, groups, episodes with pictures, timings, provenance.

::

    breakdown    success by group and by place
    content      remarks, failures, timings, provenance in words
    selection    the episodes to show
    gallery      a card for each of them: played again, with pictures from ``evaluator.render``
    scores       the policy's own maps of scores, and its calibration
    page         all of this as HTML
    writing      from a run folder to ``report.html``
"""

from evaluator.report.writing import PAGE_NAME, ReportOptions, WrittenReport, write_report

__all__ = ["PAGE_NAME", "ReportOptions", "WrittenReport", "write_report"]
