"""From residual windows to findings: tests, classifier, verdict, and the pipeline that joins them."""
