"""What proves fdd: the thesis's experiments, the plant, the estimators and the service, measured.

It is no part of what is installed. ``python -m evidence --help`` lists its commands; ``make evidence``
remakes all committed reports.
"""
