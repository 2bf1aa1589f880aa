from uniforce_vtla.commands.pretrain import main

raise SystemExit(main())
