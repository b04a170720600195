"""Second thoughts: each name that was found is judged again beside all the others, and against chance."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from hubodo.gap.judge.round import DECIDED, Round
from hubodo.gap.judge.search import SearchResult, Watch
from hubodo.gap.refit.refit import refit_with_weights

# Changes at most: two names that take each other's place would go on for ever. Of more names than so many,
# each stays as it was found: a turn costs a round for each.
_TIMES = 3
_MANY = 4
# Of the progress, where this begins, and what it is.
_FROM, _SHARE = 0.75, 0.15

Rounds = Mapping[tuple[str, str], Round]
"""By effect and scope, the round that judged it."""


def reconsider(
    found: SearchResult,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    watch: Watch | None = None,
) -> tuple[SearchResult, Rounds]:
    """Each effect that was found is taken out and looked for again beside all the others.

    What came in as a proxy for something that was found later leaves; what has a better rival is replaced.
    accept: names that stay all the same, as sure as they are. reject: names not considered.
    """
    watch, rounds = watch or Watch(), dict[tuple[str, str], Round]()
    as_found = {made.best.label: made for made in found.rounds if made.best is not None}
    terms = [term for term in found.final.state.terms if term.fitted]
    if (len(terms) == 1 and not found.decimated and not accept) or len(terms) > _MANY:
        # Alone it was judged beside all the others already; of so many, each as it was when it was found.
        return found, {term.key: as_found[term.key] for term in terms if term.key in as_found}
    final = found.final
    for turn in range(_TIMES + 1):
        changed, rounds = False, {}
        for term in [term for term in final.state.terms if term.fitted]:
            without = [other for other in final.state.terms if other.key != term.key]
            swapped = final.state.afresh(without)
            also = [term.key] if term.moves and term.effect.name in accept else []
            watch.say(f"reconsidering {term.words}", _FROM + _SHARE * turn / (_TIMES + 1))
            made = watch.journal.look(final.point.at(swapped), reject, also)
            rounds[term.key] = made
            best = made.best
            stays = term.effect.name in accept or (best is not None and best.label == term.key)
            # The last turn changes nothing: it only says how sure each name is.
            if stays or turn == _TIMES:
                continue
            if best is not None:
                swapped = swapped.with_terms([*without, best.term])
            final = refit_with_weights(swapped)
            changed = True
            break
        if not changed:
            break
    for key, made in rounds.items():
        if made.rival(key) is None and key[0] not in accept:
            # Others of its kind took its place among the rivals: it counts as it was found.
            rounds[key] = as_found.get(key, made)
    return replace(found, final=final), rounds


def beyond_chance(
    found: SearchResult, rounds: Rounds, accept: Collection[str] = ()
) -> tuple[SearchResult, Rounds]:
    """Without what the best of all candidates would gain by chance, in what the finished model leaves.

    Only of effects that show in the mean; accept: names that stay all the same.
    """
    null = found.rounds[-1].null
    by_chance = set()
    for key, made in rounds.items():
        own = made.rival(key)
        if own is not None and own.state is not None and own.p_value(null) >= 1.0 - DECIDED:
            by_chance.add(key)
    kept = [it for it in found.final.state.terms if it.key not in by_chance or it.effect.name in accept]
    if len(kept) == len(found.final.state.terms):
        return found, rounds
    return replace(found, final=refit_with_weights(found.final.state.afresh(kept))), rounds
