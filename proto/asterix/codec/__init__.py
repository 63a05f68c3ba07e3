"""What all categories share: layouts as data, and what is made from them.

`layout` reads categories, `decode` their records, by compiled `readers` of a `reader_source`.
`encode` writes these, by items of a `profile`, few at once (`scalar`, with the rule of each part)
or many (`vector`). `retime_asterix` moves times in what others wrote.
"""
