"""ASTERIX: a category is a file `catNNN`, with its layout, what writes its records and reads plots.

`categories` is the table of those that are read; reading needs no NumPy. `decode_plots` gives the
plots in data blocks, `decode_cooperative` aircraft that say where they are, and `codec` is what all
categories share.
"""
