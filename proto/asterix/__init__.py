"""ASTERIX: of each category a layout, `catNNN`, and what writes its records, `encode_NNN`.

`categories` is the table of those that are read, `decode_plots` says where their records tell of
plots, and `codec` is what all of them share.
"""
