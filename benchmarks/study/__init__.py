"""The study: every method trained and scored on the same characters, poses and budget, with tables and a report.

`benchmarks.study.plan` lists the jobs, `benchmarks.study.runner` runs those that are not done, each through
`benchmarks.study.worker`, and `benchmarks.study.outputs` writes what is known at any time.
"""
