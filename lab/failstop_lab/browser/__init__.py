"""The whole service in the reader's browser: what a static page shows of it, and how that page is built."""
