"""ASTERIX: quantities and layouts as data, and the encoders and decoders made from them."""
