"""What all categories share: layouts as data, and the decoder and encoders made from them."""
