"""Pictures: plot style, stacks, space-time maps, scenes, films, ParaView series, studies."""
