"""The error study of the estimators: on computed shapes, and on a recorded one."""

from bench.report.accuracy.page import ACCURACY_PAGE, write_study_page, write_template_page
from bench.report.accuracy.study import Study, Subject, make_paper_subjects, make_rod_subject, run_study
from bench.report.accuracy.tables import ACCURACY_FILES, write_study_tables, write_template_tables
from bench.report.accuracy.template import Template, measure_template
from bench.report.accuracy.template_text import describe_template, explain_unmeasured, judge_noise, tabulate_template
from bench.report.accuracy.text import TextTable, explain_skipped, tabulate_study

__all__ = [
    "ACCURACY_FILES",
    "ACCURACY_PAGE",
    "Study",
    "Subject",
    "Template",
    "TextTable",
    "describe_template",
    "explain_skipped",
    "explain_unmeasured",
    "judge_noise",
    "make_paper_subjects",
    "make_rod_subject",
    "measure_template",
    "run_study",
    "tabulate_study",
    "tabulate_template",
    "write_study_page",
    "write_study_tables",
    "write_template_page",
    "write_template_tables",
]
