"""One page about a run: rates, failures, groups, episodes with pictures, timings, provenance.

::

    breakdown    Run                 ->  success by group and by place
    content      Run                 ->  remarks, failures, timings, provenance in words
    selection    Run                 ->  the episodes to show
    film         episode                     ->  Take: played again from its recorded actions
    images       Take                        ->  photographs, animation, maps
    gallery      Take + pictures             ->  Card
    scores       policy + situations         ->  its maps, and its calibration
    page         all of this                 ->  HTML
    writing      run folder                  ->  report.html
"""

from evaluator.report.writing import PAGE_NAME, ReportOptions, WrittenReport, write_report

__all__ = ["PAGE_NAME", "ReportOptions", "WrittenReport", "write_report"]
