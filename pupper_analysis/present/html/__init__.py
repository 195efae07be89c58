"""Reports as one HTML file: what a result says, as a document, and the document as a page."""
