"""`assistax humans`."""

from assistax.cli.common import Count, Json, Name, print_json


def humans(*, people: Name = None, seed: Count = 0, json: Json = False) -> None:
    """Say who the person can be: the seven standard disabilities, and a preference as a sentence.

    Any of them can be trained with or evaluated on:
      assistax train scratch --set env.human.disability=tremor+weakness env.human.preference=default
      assistax train scratch --set "env.human.disability=strength=0.5 tremor=0.2 tremor_hz=4 motion=0.7"
      assistax train scratch --set "env.human.preference=speed=0.05:0.09 force=1.2:2 weights=0.3,0.35,-0.03"

    Or drawn at every reset: one of the seven and a preference of the paper's sweep; one of the paper's
    population of 630; one of your own list. The robot may be kept from seeing the preference, or see in the person's
    face alone how they take it:
      assistax train scratch --set env.human.disability=standard env.human.preference=sweep
      assistax train scratch --set env.human.people=paper630 env.human.visibility=human
      assistax train scratch --set env.human.preference=sweep env.human.visibility=shown
      assistax humans --people paper630 --json > people.json
      assistax train scratch --set env.human.people=people.json

    Args:
      people: list these instead: paper630 or a JSON file.
      seed: of the drawn preference.
      json: print JSON; with --people in the form of such a file.
    """
    import jax

    from assistax.human import DISABILITIES, disability, population, preference
    from assistax.settings import check_seed

    if people is not None:
        listed = population.people(people)
        if json:
            print_json([vars(person) for person in listed])
            return
        for i, person in enumerate(listed):
            words = "" if person.preference == "none" else preference.describe(preference.parse(person.preference))
            print(f"{i:4} {person.disability:34} {words}")
        return
    check_seed("seed", seed)
    drawn = preference.sample(jax.random.key(seed))
    words = preference.describe(drawn)
    if json:
        vector = [round(float(x), 4) for x in preference.vector(drawn)]
        ranges = {"disability": disability.RANGES, "preference": preference.RANGES, "weights": preference.WEIGHTS}
        example = {"preference": vector, "spelling": preference.spell(drawn), "words": words}
        print_json({"disabilities": DISABILITIES, "ranges": ranges, **example})
        return
    for name, parts in DISABILITIES.items():
        print(f"{name:34} {' '.join(f'{part}={value:g}' for part, value in parts.items())}")
    print(f"\nperson {seed} {words}")
