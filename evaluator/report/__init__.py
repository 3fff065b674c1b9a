"""One page about a run: rates, failures, groups, episodes with pictures, timings, provenance.

::

    finished     run folder                  ->  FinishedRun, checked against itself
    breakdown    FinishedRun                 ->  success by group and by place
    content      FinishedRun                 ->  remarks, failures, timings, provenance in words
    selection    FinishedRun                 ->  the episodes to show
    film         episode                     ->  Take: played again from its recorded actions
    images       Take                        ->  photographs, animation, maps
    gallery      Take + pictures             ->  Card
    scores       policy + situations         ->  its maps, and its calibration
    page         all of this                 ->  HTML
    writing      run folder                  ->  report.html
"""

from evaluator.report.writing import PAGE_NAME, ReportOptions, WrittenReport, write_report

__all__ = ["PAGE_NAME", "ReportOptions", "WrittenReport", "write_report"]
