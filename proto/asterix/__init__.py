"""ASTERIX: of each category a file, `catNNN`: its layout, and what writes its records.

`categories` is the table of those that are read, `decode_plots` says where their records tell of
plots, `decode_129` reads unmanned aircraft, and `codec` is what all categories share.
"""
