"""ASTERIX: of each category a layout, `layout_NNN`, and what writes its records, `catNNN`.

`categories` is the table of those that are read; reading needs no NumPy. `decode_plots` says where
their records tell of plots, `decode_129` reads unmanned aircraft, and `codec` is what all
categories share.
"""
