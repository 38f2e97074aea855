from assistax.cli import main

main()
