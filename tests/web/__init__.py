"""The operator's page as it is used: a real browser, viewers, and the measures of the page (`python -m tests.web`)."""
