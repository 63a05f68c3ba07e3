"""What all categories share: layouts as data, and what is made from them.

`layout` reads categories, `decode` their records. `encode` writes them, by the items of a `profile`
and a `scaling` rule for each part, few at once (`scalar`) or many (`vector`); `report_profiles`
keeps an encoder for each choice of items. `retime_asterix` moves times in what others wrote.
"""
