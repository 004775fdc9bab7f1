"""Pages in the browser: the viewer of results and the page on which a first pose is clicked.

A page is one HTML file with everything in it (three.js and uPlot are vendored under ``assets/vendor``), so that it
works without a network; the server listens on this machine alone.
"""
