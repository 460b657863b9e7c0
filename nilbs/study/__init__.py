"""The study: every method trained and scored on the same characters, poses and budget, with tables and a report.

`nilbs.study.plan` lists the jobs, `nilbs.study.runner` runs those that are not done, each through
`nilbs.study.worker`, and `nilbs.study.outputs` writes what is known at any time.
"""
