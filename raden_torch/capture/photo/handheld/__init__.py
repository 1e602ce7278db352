"""A phone or camera held by hand, before a card with a board: videos and stills → photographs whose
camera, lamp and response are known, for `raden capture brdf`."""
